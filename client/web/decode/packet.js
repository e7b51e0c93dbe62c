/** The outside of a packet: header, directory, checksums (codec/FORMAT.md sections 2 and 13). */

import { crc32 } from "./checksum.js";
import { BitstreamError } from "./scene.js";

export const KEY = 0;
const CHANGE = 1,
  FIRST_EXTENSION = 12;
export const Chunk = Object.freeze({
  HEADER: 0,
  WEIGHTS: 1,
  GEOMETRY: 2,
  BASE: 3,
  CHANGE: 4,
  REMOVED: 5,
  ADDED: 6,
  HASH: 7,
  METADATA: 12,
});

/** What a player takes at most: complexity level main of codec/FORMAT.md, section 13. */
export const LIMITS = Object.freeze({
  packetBytes: 16 << 20,
  levels: 16,
  anchors: 1 << 18,
  gaussians: 1 << 21,
  stateBytes: 64 << 20,
  slots: 16,
  features: 64,
});

export const HEADER = 44; // bytes before the directory
const NUMBERS_A_BYTE = 64;

/**
 * @typedef {object} Packet
 * @property {number} profile
 * @property {number} kind
 * @property {number} keyframe
 * @property {number} fromVersion
 * @property {number} toVersion
 * @property {bigint} timeNs - presentation time
 * @property {number} timeMs - the same, rounded
 * @property {number} mask
 * @property {bigint} identifier - of the keyframe
 * @property {Map<number, Uint8Array>} chunks - by level << 4 | chunk kind
 */

/**
 * Refuse by one of the codes of codec/FORMAT.md, section 13.
 * @type {(condition: unknown, code?: string, detail?: string) => asserts condition}
 */
export function must(condition, code = "corrupt_chunk", detail = code) {
  if (!condition) throw new BitstreamError(code, detail);
}

/** What the chunks of one level may hold: rows to add, and bytes. @typedef {{ rows: number, bytes: number }} Room */

/**
 * Refuse a table with too few bytes behind it (codec/FORMAT.md section 6).
 * @type {(rows: number, columns: number, room: Room) => void}
 */
export function checkTable(rows, columns, { bytes }) {
  must(rows * columns <= NUMBERS_A_BYTE * bytes, "limit_exceeded");
}

/** The same for rows that the state does not have yet. @type {(rows: number, columns: number, room: Room) => void} */
export function checkAdded(rows, columns, room) {
  must(rows <= room.rows, "limit_exceeded");
  checkTable(rows, columns, room);
}

/** Length of the chunks of a level. @type {(packet: Packet, level: number) => number} */
export function levelBytes({ chunks }, level) {
  let bytes = 0;
  for (const [key, chunk] of chunks) if (key >> 4 === level) bytes += chunk.length;
  return bytes;
}

/**
 * What a packet's header and directory say: its fields without chunks, and for each chunk where it lies.
 * @typedef {{ fields: Omit<Packet, "chunks">, directory: { key: number, at: number, length: number, crc: number }[] }} Envelope
 */

/** Chunks are not looked at. @type {(bytes: Uint8Array) => Envelope} @throws {BitstreamError} */
export function parseEnvelope(bytes) {
  must(bytes.length <= LIMITS.packetBytes, "too_large");
  must(bytes.length >= HEADER, "truncated");
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  must(view.getUint32(0, true) === 0x4b504c53, "bad_magic");
  must(bytes[4] === 1, "unsupported_version", `format version ${bytes[4]}, this page knows 1`);
  must(bytes[5] <= 1, "unsupported_profile");
  const start = HEADER + 8 * view.getUint16(30, true);
  must(bytes.length >= start, "truncated");
  const checksum = crc32(bytes.subarray(HEADER, start), crc32(bytes.subarray(0, HEADER - 4)));
  must(view.getUint32(HEADER - 4, true) === checksum, "bad_checksum");

  const kind = bytes[6],
    keyframe = view.getUint32(8, true),
    mask = view.getUint16(28, true);
  const fromVersion = view.getUint32(12, true),
    toVersion = view.getUint32(16, true);
  const ordered =
    kind === KEY
      ? keyframe === fromVersion && fromVersion === toVersion
      : keyframe <= fromVersion && fromVersion < toVersion;
  const timed = view.getUint32(24, true) < 0x80000000;
  must(kind <= CHANGE && bytes[7] === 0 && mask !== 0 && ordered && timed, "bad_header");

  /** @type {Envelope["directory"]} */
  const directory = [],
    places = new Set();
  let before = -1,
    end = start;
  for (let at = HEADER; at < start; at += 8) {
    const entry = view.getUint32(at, true);
    const level = entry >>> 28,
      chunk = (entry >>> 24) & 15,
      key = entry >>> 24,
      length = entry & 0xffffff;
    const allowed =
      chunk >= FIRST_EXTENSION ||
      chunk === Chunk.HASH ||
      (chunk < Chunk.HASH && chunk < Chunk.CHANGE === (kind === KEY));
    must(key > before && allowed, "bad_directory");
    must((mask >>> level) & 1 && (chunk > Chunk.WEIGHTS || level === 0), "bad_directory");
    before = key;
    places.add(key);
    directory.push({ key, at: end, length, crc: view.getUint32(at + 4, true) });
    end += length;
  }
  must(places.has(Chunk.HEADER) === places.has(Chunk.WEIGHTS), "missing_chunk");
  for (let level = 0; level < 16; level++) {
    const [geometry, base] = [Chunk.GEOMETRY, Chunk.BASE].map((k) => places.has((level << 4) | k));
    must(geometry === base, "missing_chunk");
  }
  must(end <= bytes.length, "truncated");
  must(end === bytes.length, "trailing_bytes");
  const timeNs = view.getBigUint64(20, true),
    timeMs = Number(timeNs / 1000n) / 1000,
    identifier = view.getBigUint64(32, true);
  return {
    fields: { profile: bytes[5], kind, keyframe, fromVersion, toVersion, timeNs, timeMs, mask, identifier },
    directory,
  };
}

/** Its chunks are views into `bytes`. @type {(bytes: Uint8Array) => Packet} @throws {BitstreamError} */
export function parsePacket(bytes) {
  const { fields, directory } = parseEnvelope(bytes);
  const chunks = new Map();
  for (const { key, at, length, crc } of directory) {
    const chunk = bytes.subarray(at, at + length);
    must(crc32(chunk) === crc, "bad_checksum");
    chunks.set(key, chunk);
  }
  return { ...fields, chunks };
}

/** Reads numbers one after the other; running out of bytes is a refusal. */
export class Reader {
  /** @param {Uint8Array} bytes @param {string} [code] - of the refusal */
  constructor(bytes, code) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 0;
    this.code = code;
  }

  /** @param {number} size */
  #skip(size) {
    must(size <= this.bytes.length - this.at, this.code);
    this.at += size;
    return this.at - size;
  }

  /** @returns {number} */
  u8() {
    return this.view.getUint8(this.#skip(1));
  }

  /** @returns {number} */
  u32() {
    return this.view.getUint32(this.#skip(4), true);
  }

  /** @returns {number} */
  i32() {
    return this.view.getInt32(this.#skip(4), true);
  }

  /** @param {number} n */
  take(n) {
    return this.bytes.subarray(this.#skip(n), this.at);
  }

  /** What is left. */
  rest() {
    return this.take(this.bytes.length - this.at);
  }

  /** @param {number} n @returns {number[]} */
  f64(n) {
    const first = this.#skip(8 * n);
    return this.#finite(Array.from({ length: n }, (_, i) => this.view.getFloat64(first + 8 * i, true)));
  }

  /** @param {number} n @returns {Float32Array} */
  f32(n) {
    const first = this.#skip(4 * n);
    return this.#finite(Float32Array.from({ length: n }, (_, i) => this.view.getFloat32(first + 4 * i, true)));
  }

  /** @param {number} n @returns {Float32Array} from half precision */
  f16(n) {
    const first = this.#skip(2 * n),
      result = new Float32Array(n);
    for (let i = 0; i < n; i++) {
      const h = this.view.getUint16(first + 2 * i, true);
      const e = (h >>> 10) & 31,
        m = h & 1023,
        sign = h & 0x8000 ? -1 : 1;
      result[i] = sign * (e === 31 ? Infinity : e ? 2 ** (e - 25) * (1024 + m) : 2 ** -24 * m);
    }
    return this.#finite(result);
  }

  /**
   * @template {ArrayLike<number> & { every: (test: (x: number) => boolean) => boolean }} A
   * @param {A} numbers
   * @returns {A}
   */
  #finite(numbers) {
    must(
      numbers.every((x) => Number.isFinite(x)),
      this.code,
    );
    return numbers;
  }

  end() {
    must(this.at === this.bytes.length, this.code);
  }
}
