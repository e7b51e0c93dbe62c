/** The index of a `.slod` file, codec/FORMAT.md section 15, and the way through it to a version. */

import { crc32 } from "./checksum.js";
import { HEADER, KEY, LIMITS, must, parseEnvelope } from "./packet.js";

/** @typedef {{ offset: number, size: number, keyframe: number, fromVersion: number, toVersion: number, timeNs: bigint, timeMs: number, kind: number, mask: number }} Entry */

export const FILE_HEAD = 8; // bytes before the first record
export const FOOTER = 16;
const ENTRY = 40,
  SIZE = 4, // of a record, before it
  INDEX_HEAD = 8;

/** Refuse other files than those of this version. @type {(head: Uint8Array) => void} */
export function checkHead(head) {
  const [name, version] = head.length === FILE_HEAD ? new Uint32Array(head.slice().buffer) : [];
  must(name === 0x444f4c53, "bad_file", "this is not a .slod file");
  must((version & 255) === 1, "unsupported_version", `file version ${version & 255}, this page knows 1`);
  must(version === 1, "bad_file", "this is not a .slod file");
}

/**
 * Where the index lies.
 * @type {(tail: Uint8Array, size: number) => { start: number, checksum: number } | null} null without a footer
 */
export function readFooter(tail, size) {
  const view = new DataView(tail.buffer, tail.byteOffset, tail.byteLength);
  if (tail.length !== FOOTER || view.getUint32(12, true) !== 0x58494c53) return null;
  const start = Number(view.getBigUint64(0, true));
  return start >= FILE_HEAD && start + INDEX_HEAD + FOOTER <= size
    ? { start, checksum: view.getUint32(8, true) }
    : null;
}

/**
 * The index, or null if it cannot be believed.
 * @type {(bytes: Uint8Array, checksum: number, end: number) => Entry[] | null} `end`: where the records end
 */
export function readIndex(bytes, checksum, end) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < INDEX_HEAD || crc32(bytes) !== checksum || view.getUint32(0, true) !== 0xffffffff) return null;
  const count = view.getUint32(4, true);
  if (bytes.length !== INDEX_HEAD + count * ENTRY) return null;
  const entries = Array.from({ length: count }, (_, i) => {
    const at = INDEX_HEAD + i * ENTRY,
      timeNs = view.getBigUint64(at + 24, true);
    return {
      offset: Number(view.getBigUint64(at, true)),
      size: view.getUint32(at + 8, true),
      keyframe: view.getUint32(at + 12, true),
      fromVersion: view.getUint32(at + 16, true),
      toVersion: view.getUint32(at + 20, true),
      timeNs,
      timeMs: Number(timeNs / 1000n) / 1000,
      kind: bytes[at + 32],
      mask: view.getUint16(at + 34, true),
    };
  });
  let at = FILE_HEAD; // where the packet before ends
  for (const { offset, size, kind } of entries) {
    if (offset < at + SIZE || size > LIMITS.packetBytes || kind > 1) return null;
    at = offset + size;
  }
  return at <= end ? entries : null;
}

/**
 * Refuse a packet whose header, as far as it has come, says otherwise than its entry.
 * @type {(entry: Entry, bytes: Uint8Array) => void}
 */
export function checkEntry({ size, keyframe, fromVersion, toVersion, timeNs, kind, mask }, bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const agrees =
    size >= HEADER &&
    (bytes.length < HEADER ||
      (bytes[6] === kind &&
        view.getUint32(8, true) === keyframe &&
        view.getUint32(12, true) === fromVersion &&
        view.getUint32(16, true) === toVersion &&
        view.getBigUint64(20, true) === timeNs &&
        view.getUint16(28, true) === mask));
  must(agrees, "bad_file", "the recording's index contradicts a packet");
}

/**
 * The entries of a file without a sound index: its records up to the first that is not a whole packet.
 * @type {(bytes: Uint8Array) => Entry[]}
 */
export function walkRecords(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  /** @type {Entry[]} */
  const entries = [];
  for (let at = FILE_HEAD; at + SIZE <= bytes.length;) {
    const size = view.getUint32(at, true),
      offset = at + SIZE;
    if (offset + size > bytes.length) break;
    try {
      entries.push({ ...parseEnvelope(bytes.subarray(offset, offset + size)).fields, offset, size });
    } catch {
      break;
    }
    at = offset + size;
  }
  return entries;
}

/**
 * Entries to decode, in order, to show `version`: on from `from`, what the decoder holds, or from the last keyframe.
 * @type {(entries: Entry[], version: number, from: { keyframe: number, version: number } | null) => number[]}
 */
export function plan(entries, version, from) {
  let keyframe = -1;
  for (const { kind, keyframe: own } of entries) if (kind === KEY && own <= version && own > keyframe) keyframe = own;
  must(keyframe >= 0, "bad_file", `the file holds no keyframe before version ${version}`);
  const parts = entries.flatMap((entry, i) => (entry.kind === KEY && entry.keyframe === keyframe ? [i] : []));
  /** @type {Map<number, { bytes: number, via: number[] , before: number }>} the cheapest way to each version */
  const best = new Map();
  best.set(keyframe, { bytes: parts.reduce((sum, i) => sum + entries[i].size, 0), via: parts, before: -1 });
  if (from && from.keyframe === keyframe && from.version <= version)
    best.set(from.version, { bytes: 0, via: [], before: -1 });
  const keyed = parts.reduce((mask, i) => mask | entries[i].mask, 0);
  for (const { from, to, bytes, via } of steps(entries, keyframe, keyed, version)) {
    const start = best.get(from),
      known = best.get(to);
    if (start && (!known || known.bytes > start.bytes + bytes))
      best.set(to, { bytes: start.bytes + bytes, via, before: from });
  }
  /** @type {number[][]} */
  const path = [];
  for (let at = version; at >= 0;) {
    const step = best.get(at);
    must(step, "bad_file", `the file holds no way to version ${version}`);
    path.push(step.via);
    at = step.before;
  }
  return path.reverse().flat();
}

/**
 * One step under a keyframe: packets that together lead all its levels from one version to another.
 * @typedef {{ from: number, to: number, bytes: number, via: number[] }} Step
 */

/**
 * All steps to versions up to `last`, by where they lead.
 * @type {(entries: Entry[], keyframe: number, keyed: number, last: number) => Step[]}
 */
function steps(entries, keyframe, keyed, last) {
  /** @type {Step[]} */
  const found = [];
  /** @type {Map<string, Step & { mask: number }>} steps of several packets, each for some of the levels */
  const partial = new Map();
  entries.forEach(({ kind, keyframe: own, fromVersion: from, toVersion: to, size, mask }, i) => {
    if (kind === KEY || own !== keyframe || from >= to || to > last) return;
    if ((mask & keyed) === keyed) return void found.push({ from, to, bytes: size, via: [i] });
    const name = `${from} ${to}`,
      step = partial.get(name) ?? { from, to, bytes: 0, via: [], mask: 0 };
    if (!(mask & keyed & ~step.mask)) return; // it brings no level
    step.mask |= mask;
    step.bytes += size;
    step.via.push(i);
    partial.set(name, step);
  });
  for (const step of partial.values()) if ((step.mask & keyed) === keyed) found.push(step);
  return found.sort((a, b) => a.to - b.to);
}

/**
 * One level of a packet as a packet of its own (codec/FORMAT.md, section 2), out of the bytes that have come so far.
 * @type {(bytes: Uint8Array, level: number) => Uint8Array | null} empty where the packet does not speak for the level, null while bytes are missing
 */
export function levelOf(bytes, level) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const start = bytes.length < HEADER ? Infinity : HEADER + 8 * view.getUint16(30, true);
  if (bytes.length < start) return null;
  if (!((view.getUint16(28, true) >> level) & 1)) return new Uint8Array(0);
  /** @type {Uint8Array[]} */
  const entries = [],
    chunks = [];
  for (let i = HEADER, at = start; i < start; i += 8) {
    const entry = view.getUint32(i, true),
      end = at + (entry & 0xffffff);
    if (entry >>> 28 === level) {
      if (bytes.length < end) return null;
      entries.push(bytes.subarray(i, i + 8));
      chunks.push(bytes.subarray(at, end));
    }
    at = end;
  }
  const part = new Uint8Array(8 * entries.length + chunks.reduce((sum, { length }) => sum + length, HEADER)),
    head = new DataView(part.buffer);
  let end = 0;
  for (const piece of [bytes.subarray(0, HEADER), ...entries, ...chunks]) {
    part.set(piece, end);
    end += piece.length;
  }
  head.setUint16(28, 1 << level, true);
  head.setUint16(30, entries.length, true);
  head.setUint32(40, crc32(part.subarray(HEADER, HEADER + 8 * entries.length), crc32(part.subarray(0, 40))), true);
  return part;
}

/**
 * The versions of a file with the time each is shown at, ascending.
 * @type {(entries: Entry[]) => { version: number, timeMs: number }[]}
 */
export function moments(entries) {
  const times = new Map(entries.map(({ toVersion, timeMs }) => [toVersion, timeMs]));
  return [...times].map(([version, timeMs]) => ({ version, timeMs })).sort((a, b) => a.version - b.version);
}
