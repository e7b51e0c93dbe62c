/** CHANGE and REMOVED chunks, codec/FORMAT.md sections 9 and 10. */

import { inflateColumns, rowCount } from "./deflate.js";
import { checkTable, must, Reader } from "./packet.js";
import { BitModels, decodeClass, RansDecoder, readScales, scale } from "./rans.js";
import { LATENTS } from "./scene.js";
import { bin } from "./tables.js";

/** @typedef {import("./scene.js").Level} Level */
/** @typedef {import("./packet.js").Room} Room */
/** @typedef {{ rows: Uint32Array, position: Int32Array, latent: Int32Array }} Change */
/** @typedef {{ age: number, span: number }} Elapsed - frames from the keyframe to the state before the change, and from that to the state after it */

const BLOCK = 64,
  MAX_SPAN = 255;

/** @type {() => Change} */
export const noChange = () => ({ rows: new Uint32Array(0), position: new Int32Array(0), latent: new Int32Array(0) });

/** @type {(chunk: Uint8Array, level: Level, elapsed: Elapsed, room: Room) => Change} */
export function decodeChange(chunk, level, elapsed, room) {
  const reader = new Reader(chunk);
  const coding = reader.u8();
  if (coding === 0) {
    const count = existing(reader, 4 + LATENTS, level, room),
      columns = inflateColumns(reader, count, 4 + LATENTS);
    const position = new Int32Array(3 * count),
      latent = new Int32Array(LATENTS * count);
    for (let i = 0; i < count; i++) {
      for (let j = 0; j < 3; j++) position[3 * i + j] = columns[(1 + j) * count + i];
      for (let j = 0; j < LATENTS; j++) latent[LATENTS * i + j] = columns[(4 + j) * count + i];
    }
    return { rows: ascending(columns, count, level.count), position, latent };
  }
  const start = scale(reader.u8());
  const scales = readScales(reader, LATENTS);
  const coder = new RansDecoder(reader.rest(), coding);
  const pairs = new Int32Array(level.latent.buffer, level.latent.byteOffset, level.latent.length / 2); // two latents at once
  const used = rowsWithAny(pairs, LATENTS / 2);
  const rows = decodeRowSet(coder, level, used);
  must(rows.length);
  const position = decodePositions(coder, rows, level.position, elapsed, start);
  const latent = decodeLatents(coder, rows, used, scales);
  coder.end();
  return { rows, position, latent };
}

/** @type {(chunk: Uint8Array, level: Level, room: Room) => Uint32Array} */
export function decodeRemoved(chunk, level, room) {
  const reader = new Reader(chunk);
  reader.u8();
  const count = existing(reader, 1, level, room);
  const rows = ascending(inflateColumns(reader, count, 1), count, level.count);
  must(rows.every((row) => level.alive[row])); // none is removed twice
  return rows;
}

/**
 * The row count of a table of a level's own rows.
 * @type {(reader: Reader, columns: number, level: Level, room: Room) => number}
 */
function existing(reader, columns, level, room) {
  const rows = rowCount(reader);
  must(rows <= level.count);
  checkTable(rows, columns, room);
  return rows;
}

/** Row numbers from their gaps. @type {(gaps: Int32Array, count: number, limit: number) => Uint32Array} */
function ascending(gaps, count, limit) {
  const rows = new Uint32Array(count);
  for (let i = 0, row = 0; i < count; i++) {
    row += gaps[i];
    must((gaps[i] > 0 || (i === 0 && row === 0)) && row < limit); // ascending, inside the level
    rows[i] = row;
  }
  return rows;
}

/** @type {(values: Int32Array, width: number) => Uint8Array} which rows are not all 0 */
function rowsWithAny(values, width) {
  const found = new Uint8Array(values.length / width);
  for (let row = 0, at = 0; row < found.length; row++) {
    let any = 0;
    for (let c = 0; c < width; c++) any |= values[at++];
    if (any) found[row] = 1;
  }
  return found;
}

/**
 * `used`: rows whose latents are no longer 0.
 * @type {(coder: RansDecoder, level: Level, used: Uint8Array) => Uint32Array}
 */
function decodeRowSet(coder, { count, position }, used) {
  const touched = rowsWithAny(position, 3);
  for (let i = 0; i < count; i++) touched[i] |= used[i];
  const blockModels = new BitModels(8),
    rowModels = new BitModels(16);
  const rows = new Uint32Array(count);
  let found = 0,
    blocks = 0,
    history = 0;
  for (let first = 0; first < count; first += BLOCK) {
    const last = Math.min(first + BLOCK, count);
    const warm = touched.subarray(first, last).includes(1) ? 4 : 0;
    const block = coder.flag(blockModels, warm + blocks);
    blocks = (block << 1) | (blocks >> 1);
    if (!block) {
      history = 0;
      continue;
    }
    for (let row = first; row < last; row++) {
      const bit = coder.flag(rowModels, 8 * touched[row] + history);
      history = (bit << 2) | (history >> 1);
      if (bit) rows[found++] = row;
    }
  }
  return rows.slice(0, found);
}

/**
 * For each changed row whether it has latents, then these.
 * @type {(coder: RansDecoder, rows: Uint32Array, used: Uint8Array, scales: import("./rans.js").Scales) => Int32Array}
 */
function decodeLatents(coder, rows, used, scales) {
  const models = new BitModels(2),
    chosen = new Uint8Array(rows.length);
  for (let i = 0; i < rows.length; i++) chosen[i] = coder.flag(models, used[rows[i]]);
  const latent = new Int32Array(rows.length * LATENTS);
  decodeClass(coder, chosen, 1, scales, latent);
  return latent;
}

/**
 * `position`: of all rows before the change; `start`: expected magnitude.
 * @type {(coder: RansDecoder, rows: Uint32Array, position: Int32Array, elapsed: Elapsed, start: number) => Int32Array}
 */
function decodePositions(coder, rows, position, { age, span }, start) {
  const delta = new Int32Array(3 * rows.length);
  const average = [start, start, start],
    trend = [0, 0, 0],
    motion = [0, 0, 0];
  const frames = Math.min(span, age, MAX_SPAN); // motion is not extrapolated for longer than it was observed
  let before = 3 * start,
    mean = 3 * start;
  for (let i = 0; i < rows.length; i++) {
    let within = 0,
      steady = 0;
    for (let a = 0; age && a < 3; a++) {
      motion[a] = Math.floor((128 * position[3 * rows[i] + a] * frames) / age);
      steady += Math.abs(motion[a]);
    }
    for (let a = 0; a < 3; a++) {
      const context = 4 * (average[a] + steady) + before + 3 * mean + 6 * within;
      const error = coder.value(bin(Math.floor(context / (18 + 6 * a))));
      const value = Math.floor((motion[a] + trend[a] + 128) / 256) + error;
      must(value === (value | 0) && value !== -2147483648);
      delta[3 * i + a] = value;
      trend[a] += 16 * value - Math.floor(trend[a] / 4);
      const size = 256 * Math.abs(error);
      average[a] += Math.floor((size - average[a]) / 64);
      within += size;
    }
    before = within;
    mean += Math.floor((within - mean) / 8);
  }
  return delta;
}
