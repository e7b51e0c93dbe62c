// The conformance vectors that the Python decoder passes, run with the page's decoder.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { levelOf } from "../../../client/web/decode/container.js";
import { SceneDecoder } from "../../../client/web/decode/decoder.js";
import { BitstreamError } from "../../../client/web/decode/scene.js";

const folder = new URL("../../vectors/", import.meta.url);
const manifest = JSON.parse(readFileSync(new URL("manifest.json", folder), "utf8"));
const COLUMNS = ["voxel", "feature", "offset", "scaling", "extraLevel", "position", "latent", "alive"];

function packets(file) {
  const bytes = new Uint8Array(readFileSync(new URL(file, folder)));
  const result = [];
  for (let at = 0; at < bytes.length; ) {
    const size = new DataView(bytes.buffer, bytes.byteOffset).getUint32(at, true);
    result.push(bytes.slice(at + 4, at + 4 + size));
    at += 4 + size;
  }
  return result;
}

function state({ scene }) {
  if (!scene) return { versions: [], levels: [] };
  const levels = scene.levels.map((level) => {
    const hash = createHash("sha256");
    for (const name of COLUMNS) hash.update(new Uint8Array(level[name].buffer, level[name].byteOffset, level[name].byteLength));
    return hash.digest("hex");
  });
  return { versions: scene.versions, levels };
}

test("there are vectors of both kinds", () => assert.ok(manifest.valid.length > 10 && manifest.broken.length > 30));

for (const { name, file, states } of manifest.valid) {
  test(`valid: ${name}`, () => {
    const decoder = new SceneDecoder();
    for (const [i, packet] of packets(file).entries()) {
      decoder.push(packet);
      assert.deepEqual(state(decoder), { versions: states[i].versions, levels: states[i].levels });
    }
  });
}

for (const { name, file, states } of manifest.valid) {
  test(`level by level, as the bytes come: ${name}`, () => {
    const whole = packets(file)[0], decoder = new SceneDecoder();
    let level = 0;
    for (let end = 0; end <= whole.length; end = end === whole.length ? end + 1 : Math.min(whole.length, end + 97)) {
      for (let part; level < 16 && (part = levelOf(whole.subarray(0, end), level)); level++) if (part.length) decoder.push(part);
      if (end < whole.length - 97) assert.ok(level < 16);
    }
    assert.equal(level, 16);
    assert.deepEqual(state(decoder), { versions: states[0].versions, levels: states[0].levels });
  });
}

for (const { name, file, refused } of manifest.broken) {
  test(`broken: ${name}`, () => {
    const decoder = new SceneDecoder();
    const list = packets(file);
    for (const packet of list.slice(0, -1)) decoder.push(packet);
    const before = state(decoder);
    assert.throws(() => decoder.push(list.at(-1)), (error) => {
      assert.ok(error instanceof BitstreamError, String(error.stack));
      assert.equal(error.code, refused);
      return true;
    });
    assert.deepEqual(state(decoder), before);
  });
}
