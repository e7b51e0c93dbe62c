// The conformance vectors that the Python decoder passes, run with the page's decoder.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { checkEntry, checkHead, FILE_HEAD, FOOTER, levelOf, plan, readFooter, readIndex, walkRecords } from "../../../client/web/decode/container.js";
import { SceneDecoder } from "../../../client/web/decode/decoder.js";
import { readMetadata } from "../../../client/web/decode/metadata.js";
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

/** Facts by their names in the document. */
function factsOf({ scene }) {
  const { metresPerUnit: unit, up, epochNs, title, licence, original: o, exposures } = readMetadata(scene.metadata ?? new Uint8Array(0));
  return JSON.parse(JSON.stringify({ unit, up, epoch: epochNs?.toString(), title, licence, original: o && [o.scale, ...o.rotation, ...o.translation], exposures }));
}

for (const { name, file, states, metadata } of manifest.valid) {
  test(`valid: ${name}`, () => {
    const decoder = new SceneDecoder();
    for (const [i, packet] of packets(file).entries()) {
      decoder.push(packet);
      assert.deepEqual(state(decoder), { versions: states[i].versions, levels: states[i].levels });
    }
    assert.deepEqual(factsOf(decoder), metadata ?? {});
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

const frozen = JSON.parse(readFileSync(new URL("frozen.json", folder), "utf8"));
const read = (/** @type {string} */ file) => new Uint8Array(readFileSync(new URL(file, folder)));

for (const [file, { states, packets }] of Object.entries(frozen.recordings)) {
  test(`every version of a recording is what it was on the day of the freeze: ${file}`, () => {
    const bytes = read(file), footer = readFooter(bytes.subarray(-FOOTER), bytes.length);
    checkHead(bytes.subarray(0, FILE_HEAD));
    const entries = readIndex(bytes.subarray(footer.start, -FOOTER), footer.checksum, footer.start);
    assert.equal(entries.length, packets);
    const places = (/** @type {{ offset: number, size: number }[]} */ found) => found.map(({ offset, size }) => ({ offset, size }));
    assert.deepEqual(places(walkRecords(bytes.subarray(0, footer.start))), places(entries));
    for (const [version, wanted] of Object.entries(states)) {
      const decoder = new SceneDecoder();
      for (const i of plan(entries, Number(version), null)) decoder.push(bytes.slice(entries[i].offset, entries[i].offset + entries[i].size));
      assert.deepEqual(state(decoder), wanted);
    }
  });
}

/** State after these packets, without those to seek with; or the first refusal, as in the manifest. */
function decoded(bytes, entries, numbers) {
  const decoder = new SceneDecoder();
  for (const i of numbers) {
    const { offset, size } = entries[i], packet = bytes.slice(offset, offset + size);
    try {
      checkEntry(entries[i], packet);
      decoder.push(packet);
    } catch (error) {
      assert.ok(error instanceof BitstreamError, String(error.stack));
      if (error.code !== "version_mismatch") return { refused: error.code, packet: i };
    }
  }
  return state(decoder);
}

for (const { file, indexed, packets, in_order: inOrder, ways } of manifest.files) {
  test(`read as the Python reader reads it: ${file}`, () => {
    const bytes = read(file), footer = readFooter(bytes.subarray(-FOOTER), bytes.length);
    const found = footer && readIndex(bytes.subarray(footer.start, -FOOTER), footer.checksum, footer.start);
    assert.equal(found !== null, indexed);
    const entries = found ?? walkRecords(bytes);
    assert.equal(entries.length, packets);
    assert.deepEqual(decoded(bytes, entries, entries.keys()), inOrder);
    assert.deepEqual([...new Set(entries.map(({ toVersion }) => toVersion))].sort((a, b) => a - b).map(String), Object.keys(ways));
    for (const [version, way] of Object.entries(ways)) {
      if (!way) assert.throws(() => plan(entries, Number(version), null), { code: "bad_file" });
      else {
        const numbers = plan(entries, Number(version), null);
        assert.deepEqual({ numbers, ...decoded(bytes, entries, numbers) }, way);
      }
    }
  });
}

test("the way through a long file, and one with a million key packets, is found", () => {
  const entry = (from, to, more = {}) => ({ offset: 0, size: 9, keyframe: 0, fromVersion: from, toVersion: to, timeNs: 0n, timeMs: 0, kind: 1, mask: 3, ...more });
  const keys = Array.from({ length: 1e6 }, () => entry(0, 0, { kind: 0 }));
  const chain = Array.from({ length: 1e5 }, (_, i) => [entry(i, i + 1, { mask: 1 }), entry(i, i + 1, { mask: 2 })]).flat();
  assert.equal(plan([...keys, ...chain], 1e5, null).length, 1.2e6);
});

test("a file of another version is refused as such, another file as none", () => {
  const head = read("growth.slod").subarray(0, FILE_HEAD);
  const other = (/** @type {number} */ at, /** @type {number} */ value) => head.with(at, value);
  for (const version of [0, 2, 255]) assert.throws(() => checkHead(other(4, version)), { code: "unsupported_version" });
  for (const wrong of [other(0, 0), other(7, 1), head.subarray(0, 7)]) assert.throws(() => checkHead(wrong), { code: "bad_file" });
});

test("a packet of another version is refused whatever else it holds", () => {
  const packet = packets("valid-growth-profile1.slps")[0];
  for (const version of [0, 2, 255]) {
    for (const rest of [packet.subarray(5), new Uint8Array(60).fill(255)]) {
      const later = Uint8Array.from([...packet.subarray(0, 4), version, ...rest]);
      assert.throws(() => new SceneDecoder().push(later), { code: "unsupported_version" });
    }
  }
});

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
