/** `node three_reads.mjs FILE...`: what the loaders of three.js make of snapshots, one line of JSON each. */

import { readFileSync } from "node:fs";
import { GLTFGaussianSplatLoaderExtension } from "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { GaussianSplatPLYLoader } from "three/addons/loaders/GaussianSplatPLYLoader.js";
import { SPZLoader } from "three/addons/loaders/SPZLoader.js";

/** @type {Record<string, (bytes: ArrayBuffer) => any>} */
const READERS = {
  ply: (bytes) => new GaussianSplatPLYLoader().parse(bytes),
  spz: (bytes) => new SPZLoader().parse(bytes),
  glb: async (bytes) => {
    const { scene } = await new GLTFLoader().register((parser) => new GLTFGaussianSplatLoaderExtension(parser)).parseAsync(bytes, "");
    let found = null;
    scene.traverse((object) => (found = object.splatGeometry ?? found));
    return found;
  },
};

for (const name of process.argv.slice(2)) {
  const file = readFileSync(name), bytes = file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
  const { attributes } = await READERS[name.split(".").pop() ?? ""](bytes);
  console.log(JSON.stringify(Object.fromEntries(["position", "covariance", "color"].map((key) => [key, Array.from(attributes[key].array)]))));
}
