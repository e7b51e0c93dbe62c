// What the page draws from the origins of rays, and finds along them: `node picks.mjs FILE RAYS OUT`; RAYS holds [[origin, direction], ...] as JSON.
import { readFileSync, writeFileSync } from "node:fs";
import { walkRecords } from "../../../client/web/decode/container.js";
import { loadKernel } from "../../../client/web/decode/expand.js";
import { Engine } from "../../../client/web/view/engine.js";

const [file, rays, out] = process.argv.slice(2);
const bytes = new Uint8Array(readFileSync(file));
const kernel = await loadKernel(readFileSync(new URL("../../../client/web/decode/kernel.wasm", import.meta.url)));
const found = JSON.parse(readFileSync(rays, "utf8")).map(([origin, direction]) => {
  const engine = new Engine(kernel);
  for (const { offset, size } of walkRecords(bytes)) engine.push(bytes.slice(offset, offset + size));
  const { splats } = engine.picture({ position: origin, rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], levels: 99, reach: Infinity });
  return [engine.pick(origin, direction), engine.depthAlong(origin, direction), splats];
});
writeFileSync(out, JSON.stringify(found));
