/**
 * A stream in a scene of three.js, drawn by Spark (@sparkjsdev/spark 2.2). docs/engines.md says more.
 *
 *     const splats = new StreamlodSplats();
 *     scene.add(new SparkRenderer({ renderer, ...DRAWN_AS_TRAINED }), splats);
 *     follow(await open(address), (frame) => splats.take(frame));
 */

import { ExtSplats, SplatMesh, utils } from "@sparkjsdev/spark";
import { decompose } from "./frame.js";

const GRAIN = 2048; // Spark's buffers hold multiples of it

/** Settings of SparkRenderer with which it filters, cuts and sorts as streamlod's page does (docs/numerics.md). */
export const DRAWN_AS_TRAINED = {
  sortRadial: false,
  preBlurAmount: 0.1,
  blurAmount: 0,
  minAlpha: 1 / 255,
  maxStdDev: Math.sqrt(2 * Math.log(255)),
};

/** Buffers for a quarter more than `count`. @param {number} count */
function roomFor(count) {
  const words = 4 * GRAIN * Math.ceil((1.25 * count + 1) / GRAIN);
  return new ExtSplats({ extArrays: [new Uint32Array(words), new Uint32Array(words)], numSplats: count });
}

export class StreamlodSplats extends SplatMesh {
  constructor() {
    const room = roomFor(0);
    super({ extSplats: room });
    this.room = room;
  }

  /** Rewrite what changed. @param {import("./frame.js").Frame} frame */
  take({ count, positions, covariances, opacities, colors, changes }) {
    if (this.room.maxSplats < count) {
      this.room.dispose();
      this.room = this.extSplats = this.splats = roomFor(count);
      changes = [{ first: 0, count }];
    }
    const { extArrays, textures } = this.room,
      scales = [0, 0, 0],
      rotation = [0, 0, 0, 1];
    for (const { first, count: length } of changes) {
      for (let i = first, o = 3 * first; i < first + length; i++, o += 3) {
        if (opacities[i] > 0) decompose(covariances, i, scales, rotation);
        const [sx, sy, sz] = scales,
          [qx, qy, qz, qw] = rotation;
        utils.encodeExtSplat(
          extArrays,
          i,
          positions[o],
          positions[o + 1],
          positions[o + 2],
          sx,
          sy,
          sz,
          qx,
          qy,
          qz,
          qw,
          opacities[i],
          colors[o],
          colors[o + 1],
          colors[o + 2],
        );
      }
    }
    this.room.numSplats = count;
    for (const texture of textures) texture.needsUpdate = true;
    this.updateVersion();
  }
}
