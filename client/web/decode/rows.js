/** Rows of a level: BASE and ADDED chunks, codec/FORMAT.md sections 8 and 10. */

import { inflateColumns, rowCount } from "./deflate.js";
import { checkAdded, checkTable, must, Reader } from "./packet.js";
import { BitModels, decodeClass, RansDecoder, readScales } from "./rans.js";
import { emptyLevel, LATENTS, SCALINGS } from "./scene.js";

const CENTRED = 1,
  TREND = 2; // channel modes

/** @typedef {import("./scene.js").Level} Level */
/** @typedef {import("./packet.js").Room} Room */

/** @type {(chunk: Uint8Array, voxel: Int32Array, features: number, slots: number, room: Room) => Level} */
export function decodeBase(chunk, voxel, features, slots, room) {
  const count = voxel.length / 3,
    channels = features + 3 * slots + 10;
  const reader = new Reader(chunk),
    coding = reader.u8();
  must(coding || rowCount(reader) === count);
  checkTable(count, channels, room);
  const columns = decodeRows(reader, coding, count, channels, 0, channels - 4);
  const level = emptyLevel(features, slots, count);
  level.voxel.set(voxel);
  level.alive.fill(1);
  fillBase(level, columns, 0, features, slots);
  return level;
}

/** @type {(chunk: Uint8Array, features: number, slots: number, room: Room) => Level} */
export function decodeAdded(chunk, features, slots, room) {
  const channels = features + 3 * slots + 38;
  const reader = new Reader(chunk),
    coding = reader.u8(),
    rows = rowCount(reader);
  checkAdded(rows, channels, room);
  const table = decodeRows(reader, coding, rows, channels, 3, 3 + features + 3 * slots + SCALINGS);
  const level = emptyLevel(features, slots, rows);
  fill(level.voxel, 3, table, 0);
  fillBase(level, table, 3, features, slots);
  fill(level.latent, LATENTS, table, channels - 1 - LATENTS);
  fill(level.alive, 1, table, channels - 1);
  must(
    level.alive.every((x) => x <= 1),
    "overflow",
  );
  return level;
}

/**
 * Values so that channel c of row i is at `i * rowStep + c * channelStep`.
 * @typedef {{ rows: number, values: Int32Array, rowStep: number, channelStep: number }} Table
 */

/** @type {(level: Level, table: Table, first: number, features: number, slots: number) => void} */
function fillBase(level, table, first, features, slots) {
  fill(level.feature, features, table, first);
  fill(level.offset, 3 * slots, table, first + features);
  fill(level.scaling, SCALINGS, table, first + features + 3 * slots);
  fill(level.extraLevel, 1, table, first + features + 3 * slots + SCALINGS);
  fill(level.position, 3, table, first + features + 3 * slots + SCALINGS + 1);
}

/** @type {(column: Int32Array | Int16Array | Uint8Array, width: number, table: Table, first: number) => void} */
function fill(column, width, { rows, values, rowStep, channelStep }, first) {
  for (let i = 0; i < rows; i++) {
    for (let j = 0; j < width; j++) {
      const value = values[i * rowStep + (first + j) * channelStep];
      column[i * width + j] = value;
      must(column[i * width + j] === value, "overflow");
    }
  }
}

/**
 * @param {Reader} reader - behind the row count
 * @param {number} coding
 * @param {number} rows
 * @param {number} channels
 * @param {number} first - channels from here on are shifted by their row's class
 * @param {number} end - up to here
 * @returns {Table}
 */
function decodeRows(reader, coding, rows, channels, first, end) {
  if (coding === 0) return { rows, values: inflateColumns(reader, rows, channels), rowStep: 1, channelStep: rows };
  const packed = reader.take(Math.ceil(channels / 4));
  const modes = Array.from({ length: channels }, (_, c) => (packed[c >> 2] >> (2 * (c & 3))) & 3);
  must(channels % 4 === 0 || packed[channels >> 2] >> (2 * (channels & 3)) === 0);
  must(modes.every((mode) => mode <= TREND));
  const centres = modes.map((mode) => (mode === CENTRED ? reader.i32() : 0));
  const { values, shifts } = decodeClasses(reader, coding, rows, channels);
  const totals = new Float64Array(channels);
  for (let i = 0, at = 0; i < rows; i++) {
    for (let c = 0; c < channels; c++, at++) {
      const unit = c >= first && c < end ? 1 << shifts[i] : 1;
      let value = values[at] * unit + centres[c];
      if (modes[c] === TREND) {
        const mean = Math.floor(totals[c] / 8);
        value += Math.floor((mean + (unit >> 1)) / unit) * unit;
        totals[c] += value - mean;
      }
      if (value !== (value | 0)) must(false, "overflow");
      values[at] = value;
    }
  }
  return { rows, values, rowStep: channels, channelStep: 1 };
}

/**
 * Rows in classes of precision, FORMAT.md section 6.4.
 * @type {(reader: Reader, coding: number, rows: number, channels: number) => { values: Int32Array, shifts: Uint8Array }}
 */
function decodeClasses(reader, coding, rows, channels) {
  const mask = reader.u8(),
    used = [0, 1, 2, 3, 4, 5, 6, 7].filter((s) => (mask >> s) & 1);
  must(mask > 0);
  const scales = used.map(() => readScales(reader, channels));
  const coder = new RansDecoder(reader.rest(), coding);
  const models = new BitModels(8),
    classes = new Uint8Array(rows),
    values = new Int32Array(rows * channels);
  for (let i = 0; i < rows; i++) {
    let own = 0;
    while (own < used.length - 1 && !coder.flag(models, own)) own++;
    classes[i] = own;
  }
  scales.forEach((own, k) => decodeClass(coder, classes, k, own, values));
  coder.end();
  return { values, shifts: classes.map((k) => used[k]) };
}
