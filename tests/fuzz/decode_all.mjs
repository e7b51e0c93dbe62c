// Decodes streams with the page's decoder: `node decode_all.mjs FILE` prints, for each, what its last packet came to.
// FILE: for each stream u32 count, then so many times u32 size and a packet. Each refusal must be a BitstreamError and
// change nothing; no stream may take more than a second.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { SceneDecoder } from "../../client/web/decode/decoder.js";
import { BitstreamError } from "../../client/web/decode/scene.js";

const COLUMNS = ["voxel", "feature", "offset", "scaling", "extraLevel", "position", "latent", "alive"];
const bytes = new Uint8Array(readFileSync(process.argv[2]));
const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

function hash(level) {
  const sum = createHash("sha256");
  for (const name of COLUMNS) sum.update(new Uint8Array(level[name].buffer, level[name].byteOffset, level[name].byteLength));
  return sum.digest("hex");
}

const found = [];
for (let at = 0; at < bytes.length; ) {
  const decoder = new SceneDecoder();
  let left = view.getUint32(at, true);
  at += 4;
  for (; left > 0; left--) {
    const size = view.getUint32(at, true), packet = bytes.slice(at + 4, at + 4 + size);
    at += 4 + size;
    const before = decoder.scene, begin = process.cpuUsage();
    let outcome;
    try {
      decoder.push(packet);
      outcome = left === 1 ? ["", decoder.scene.versions, decoder.scene.levels.map(hash)] : [];
    } catch (error) {
      if (!(error instanceof BitstreamError) || left > 1) throw error;
      assert.equal(decoder.scene, before);
      outcome = [error.code];
    }
    const { user, system } = process.cpuUsage(begin);
    assert.ok(user + system < 1e6, "a packet takes more than a second");
    if (left === 1) found.push(outcome);
  }
}
console.log(JSON.stringify(found));
