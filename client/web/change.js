/** CHANGE and REMOVED chunks: which rows of a level differ, and by how much; codec/FORMAT.md sections 9 and 10. */

import { inflateColumns } from "./deflate.js";
import { must, Reader } from "./packet.js";
import { BitModels, decodeColumns, RansDecoder, readScales, scale } from "./rans.js";
import { LATENTS } from "./scene.js";
import { bin } from "./tables.js";

/** @typedef {import("./scene.js").Level} Level */
/** @typedef {{ rows: Uint32Array, position: Int32Array, latent: Int32Array }} Change */

const BLOCK = 64;

/** @type {() => Change} */
export const noChange = () => ({ rows: new Uint32Array(0), position: new Int32Array(0), latent: new Int32Array(0) });

/** @type {(chunk: Uint8Array, level: Level) => Change} */
export function decodeChange(chunk, level) {
  const reader = new Reader(chunk, "corrupt_chunk");
  const coding = reader.u8();
  if (coding === 0) {
    const { rows: count, columns } = inflateColumns(chunk, 4 + LATENTS, level.count);
    const position = new Int32Array(3 * count), latent = new Int32Array(LATENTS * count);
    for (let i = 0; i < count; i++) {
      for (let j = 0; j < 3; j++) position[3 * i + j] = columns[(1 + j) * count + i];
      for (let j = 0; j < LATENTS; j++) latent[LATENTS * i + j] = columns[(4 + j) * count + i];
    }
    return { rows: ascending(columns, count, level.count), position, latent };
  }
  const first = reader.u8();
  const start = scale(first & 127), predict = first < 128;
  const scales = readScales(reader, LATENTS);
  const coder = new RansDecoder(reader.rest(), coding);
  const pairs = new Int32Array(level.latent.buffer, level.latent.byteOffset, level.latent.length / 2); // two latents at once
  const used = rowsWithAny(pairs, LATENTS / 2);
  const rows = decodeRowSet(coder, level, used);
  const position = decodePositions(coder, rows, level.voxel, start, predict);
  const latent = decodeLatents(coder, rows, used, scales);
  coder.end();
  return { rows, position, latent };
}

/** @type {(chunk: Uint8Array, level: Level) => Uint32Array} */
export function decodeRemoved(chunk, level) {
  const { rows, columns } = inflateColumns(chunk, 1, level.count);
  return ascending(columns, rows, level.count);
}

/** Row numbers from their gaps. @type {(gaps: Int32Array, count: number, limit: number) => Uint32Array} */
function ascending(gaps, count, limit) {
  const rows = new Uint32Array(count);
  for (let i = 0, row = 0; i < count; i++) {
    row += gaps[i];
    must((gaps[i] > 0 || (i === 0 && row === 0)) && row < limit, "corrupt_chunk", "rows must ascend and lie inside the level");
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
 * @param {RansDecoder} coder
 * @param {Level} level
 * @param {Uint8Array} used - rows whose latents are no longer 0
 * @returns {Uint32Array}
 */
function decodeRowSet(coder, { count, position }, used) {
  const touched = rowsWithAny(position, 3);
  for (let i = 0; i < count; i++) touched[i] |= used[i];
  const blockModels = new BitModels(8), rowModels = new BitModels(16);
  const rows = new Uint32Array(count);
  let found = 0, blocks = 0, history = 0;
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

/** Which rows have any latents, then these. @type {(coder: RansDecoder, rows: Uint32Array, used: Uint8Array, scales: import("./rans.js").Scales) => Int32Array} */
function decodeLatents(coder, rows, used, scales) {
  const models = new BitModels(4), chosen = new Uint8Array(rows.length);
  let found = 0;
  for (let i = 0, before = 0; i < rows.length; i++) {
    before = coder.flag(models, 2 * before + used[rows[i]]);
    chosen[i] = before;
    found += before;
  }
  const part = decodeColumns(coder, found, scales);
  const latent = new Int32Array(rows.length * LATENTS);
  for (let i = 0, from = 0; i < rows.length; i++) {
    if (!chosen[i]) continue;
    latent.set(part.subarray(from, from + LATENTS), i * LATENTS);
    from += LATENTS;
  }
  return latent;
}

/** Changed rows by their voxel: an open-addressed table of row indices. */
class VoxelTable {
  /** @param {Uint32Array} rows @param {Int32Array} voxel */
  constructor(rows, voxel) {
    this.mask = 2 ** Math.ceil(Math.log2(2 * rows.length + 2)) - 1;
    this.entry = new Int32Array(this.mask + 1); // index + 1, 0 where free
    this.rows = rows;
    this.voxel = voxel;
  }

  /** The place of a voxel: where it is, or would be. @type {(x: number, y: number, z: number) => number} */
  place(x, y, z) {
    let at = (Math.imul(x, 0x9e3779b1) ^ Math.imul(y, 0x85ebca6b) ^ Math.imul(z, 0xc2b2ae35));
    at = (at ^ (at >>> 15)) & this.mask;
    for (; this.entry[at]; at = (at + 1) & this.mask) {
      const v = 3 * this.rows[this.entry[at] - 1];
      if (this.voxel[v] === x && this.voxel[v + 1] === y && this.voxel[v + 2] === z) break;
    }
    return at;
  }
}

/** @type {(coder: RansDecoder, rows: Uint32Array, voxel: Int32Array, start: number, predict: boolean) => Int32Array} */
function decodePositions(coder, rows, voxel, start, predict) {
  const delta = new Int32Array(3 * rows.length);
  const table = new VoxelTable(rows, voxel);
  const mean = [start, start, start], sum = [0, 0, 0];
  let before = 3 * start, earlier = 3 * start;
  for (let i = 0; i < rows.length; i++) {
    const x = voxel[3 * rows[i]], y = voxel[3 * rows[i] + 1], z = voxel[3 * rows[i] + 2];
    let near = 0;
    sum.fill(0);
    for (let dx = predict ? -1 : 2; dx <= 1; dx++) {
      for (let dy = -1; dy <= 1; dy++) {
        for (let dz = -1; dz <= 1; dz++) {
          const j = table.entry[table.place(x + dx, y + dy, z + dz)] - 1;
          if (j < 0) continue;
          near++;
          for (let a = 0; a < 3; a++) sum[a] += delta[3 * j + a];
        }
      }
    }
    let size = 0;
    for (let a = 0; a < 3; a++) {
      let predicted = predict && i ? delta[3 * (i - 1) + a] : 0;
      if (predict && near) predicted = Math.floor((2 * sum[a] + near) / (2 * near));
      const context = Math.floor((6 * mean[a] + 6 * before + 4 * earlier + 9 * 256 * size) / (36 + 9 * a));
      const error = coder.value(bin(context));
      const value = predicted + error;
      must(value === (value | 0) && value !== -2147483648, "corrupt_chunk", "a position difference is too large");
      delta[3 * i + a] = value;
      const magnitude = Math.abs(error);
      mean[a] += Math.floor((256 * magnitude - mean[a]) / 64);
      size += magnitude;
    }
    earlier = before;
    before = 256 * size;
    if (predict) table.entry[table.place(x, y, z)] = i + 1;
  }
  return delta;
}
