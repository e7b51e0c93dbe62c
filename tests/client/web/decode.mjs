// Decodes a .slod file with the page's own modules and writes what it holds: `node decode.mjs FILE OUT X Y Z LEVELS`.
// OUT.json: versions and digests after each packet; OUT.bin: the splats of the last state seen from (X, Y, Z).
import { readFileSync, writeFileSync } from "node:fs";
import { digest } from "../../../client/web/decode/checksum.js";
import { walkRecords } from "../../../client/web/decode/container.js";
import { Engine } from "../../../client/web/view/engine.js";
import { loadKernel, RECORD } from "../../../client/web/decode/expand.js";
import { BitstreamError } from "../../../client/web/decode/scene.js";

const [file, out, x, y, z, levels] = process.argv.slice(2);
const bytes = new Uint8Array(readFileSync(file));
const kernel = await loadKernel(readFileSync(new URL("../../../client/web/decode/kernel.wasm", import.meta.url)));
const engine = new Engine(kernel);
const view = { position: [Number(x), Number(y), Number(z)], rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], levels: Number(levels) };
const log = [];
for (const { offset, size } of walkRecords(bytes)) {
  let code = "";
  try {
    engine.push(bytes.slice(offset, offset + size));
  } catch (error) {
    if (!(error instanceof BitstreamError)) throw error;
    code = error.code;
  }
  engine.picture(view);
  log.push({ code, versions: engine.scene?.versions ?? [], digests: engine.scene?.levels.map(digest) ?? [] });
}
const shown = new Float32Array(engine.activeCount * RECORD);
for (let i = 0; i < engine.activeCount; i++) {
  const at = engine.active[i] * RECORD;
  shown.set(engine.expander.numbers.subarray(at, at + RECORD), i * RECORD);
}
writeFileSync(`${out}.json`, JSON.stringify(log));
writeFileSync(`${out}.bin`, shown);
