/**
 * Anchors to Gaussians for one view, the arithmetic of core/scene/expand.py; the matrix products run in kernel.wasm.
 *
 * Splats live in one array that mirrors the renderer's texture: anchor number a (in order of arrival, all levels) owns
 * splats K a to K a + K - 1, RECORD numbers each: mean 3, opacity 1, covariance xx xy xz yy yz zz, colour as two
 * 16-bit unsigned fractions (red, green) and one (blue). Opacity 0 means not shown.
 */

import { FEATURE_LATENTS, HIDDEN, LATENTS } from "./scene.js";

/** @typedef {import("./scene.js").Level} Level */

export const RECORD = 12;
export const ROW_SPLATS = 512; // splats in one row of the renderer's texture
export const MIN_ALPHA = 1 / 255; // weaker splats are not drawn
const VIEW_INPUTS = 4;
const MAX_LOG_SCALE = 20;
const MIN_LENGTH = 1e-12,
  MAX_LENGTH = 1e12; // lengths of quaternions that say a rotation
const BATCH = 256; // anchors in the kernel's memory at once

/**
 * @typedef {object} Kernel
 * @property {WebAssembly.Memory} memory
 * @property {(pairs: number, x: number, inputs: number, w: number, b: number, y: number, blocks: number, rectify: number) => void} dense
 * @property {(p: number, rows: number, stride: number, vectors: number) => void} sigmoid
 */

/** @type {(bytes: BufferSource) => Promise<Kernel>} */
export async function loadKernel(bytes) {
  const { instance } = await WebAssembly.instantiate(bytes);
  return /** @type {any} */ (instance.exports);
}

/** @type {(n: number, step: number) => number} */
const roundUp = (n, step) => Math.ceil(n / step) * step;

/**
 * Columns of `matrix` [inputs, columns] into blocks of 16, padded with zeros: the order in which the kernel reads weights.
 * `place` is where each column goes, `gain` a factor of it.
 * @type {(out: Float32Array, matrix: Float32Array, inputs: number, place: number[], gain: number[]) => void}
 */
function intoBlocks(out, matrix, inputs, place, gain) {
  out.fill(0);
  const columns = place.length;
  for (let i = 0; i < inputs; i++) {
    for (let j = 0; j < columns; j++) {
      const to = place[j];
      out[((to >> 4) * inputs + i) * 16 + (to & 15)] = matrix[i * columns + j] * gain[j];
    }
  }
}

/** What dequantising a level once leaves to do for each view. */
class LevelFloats {
  /** @param {number} features @param {number} slots */
  constructor(features, slots) {
    this.base = new Int32Array(0); // anchor number of each row
    this.anchor = new Float32Array(0); // [N, 3]
    this.feature = new Float32Array(0); // [N, F]
    this.local = new Float32Array(0); // [N, 3K] offset x size
    this.size = new Float32Array(0); // [N, 3] of the Gaussians
    this.widths = { base: 1, anchor: 3, feature: features, local: 3 * slots, size: 3 };
  }

  /** @param {number} rows */
  reserve(rows) {
    if (this.base.length >= rows) return;
    const room = this.base.length ? Math.ceil(rows * 1.25) : rows,
      all = /** @type {any} */ (this);
    for (const [name, width] of Object.entries(this.widths)) {
      const old = all[name];
      all[name] = new old.constructor(width * room);
      all[name].set(old);
    }
  }
}

/** The splats of one scene under one keyframe. */
export class Expander {
  /**
   * @param {import("./scene.js").Scene} scene - read, never changed
   * @param {Kernel} kernel
   */
  constructor(scene, kernel) {
    const { header, weights } = scene;
    this.scene = scene;
    this.kernel = kernel;
    const slots = (this.slots = header.slots);
    const features = (this.features = header.featureSteps.length);
    this.inputs = features + (header.viewDependent ? VIEW_INPUTS : 0);
    this.rotations = roundUp(7 * slots, 4); // column where the quaternions begin
    this.columns = roundUp(this.rotations + 4 * slots, 16);
    this.levels = scene.levels.map(() => new LevelFloats(features, slots));
    this.anchors = 0;
    this.splats = new Uint32Array(0);
    this.numbers = new Float32Array(0); // the same memory
    /** @type {Set<number>} texture rows written since `takeDirty` */
    this.dirty = new Set();

    // The kernel's memory: both layers, then inputs, hidden values and outputs of a batch.
    const sizes = [
      HIDDEN * this.inputs,
      HIDDEN,
      HIDDEN * this.columns,
      this.columns,
      BATCH * this.inputs,
      BATCH * HIDDEN,
      BATCH * this.columns,
    ];
    const start = [0];
    for (const size of sizes) start.push(start[start.length - 1] + roundUp(4 * size, 16));
    const missing = start[sizes.length] - kernel.memory.buffer.byteLength;
    if (missing > 0) kernel.memory.grow(Math.ceil(missing / 65536));
    const at = sizes.map((size, i) => new Float32Array(kernel.memory.buffer, start[i], size));
    this.pointers = start;
    this.x = at[4];
    this.y = at[6];
    const natural = Array.from({ length: HIDDEN }, (_, i) => i);
    intoBlocks(
      at[0],
      weights.hiddenWeight,
      this.inputs,
      natural,
      natural.map(() => 1),
    );
    at[1].set(weights.hiddenBias);
    // tanh(v) = 2 sigmoid(2v) - 1, so that one function serves opacities, colours and scales.
    const all = Array.from({ length: 11 * slots }, (_, j) => j);
    const place = all.map((j) => (j < 7 * slots ? j : j - 7 * slots + this.rotations));
    const gain = all.map((j) => (j < slots ? 2 : 1));
    intoBlocks(at[2], weights.outputWeight, HIDDEN, place, gain);
    at[3].fill(0);
    for (const j of all) at[3][place[j]] = weights.outputBias[j] * gain[j];
    for (let k = 0; k < slots; k++) at[3][this.rotations + 4 * k] += 1; // rotations are relative to (1, 0, 0, 0)
    this.latents = new Float32Array(LATENTS);
  }

  /**
   * Take over rows that are new or whose integers changed.
   * @param {number} number - level
   * @param {ArrayLike<number>} rows
   */
  refresh(number, rows) {
    const { header, weights } = this.scene;
    const level = this.scene.levels[number],
      floats = this.levels[number];
    const { features, slots, latents } = this;
    floats.reserve(level.count);
    const cell = header.rootCell / 2 ** number,
      step = header.positionSteps[number];
    const width = 3 * slots;
    for (let i = 0; i < rows.length; i++) {
      const r = rows[i];
      for (let j = 0; j < 3; j++) {
        const node = header.origin[j] + level.voxel[3 * r + j] * cell;
        floats.anchor[3 * r + j] = node + level.position[3 * r + j] * step;
      }
      for (let j = 0; j < LATENTS; j++) latents[j] = level.latent[LATENTS * r + j];
      const f = features * r,
        o = width * r;
      for (let j = 0; j < features; j++) floats.feature[f + j] = level.feature[f + j] * header.featureSteps[j];
      for (let j = 0; j < width; j++) floats.local[o + j] = level.offset[o + j] * header.offsetSteps[j];
      for (let l = 0; l < FEATURE_LATENTS; l++) {
        const a = latents[l],
          b = latents[FEATURE_LATENTS + l];
        if (a !== 0)
          for (let j = 0; j < features; j++) floats.feature[f + j] += a * weights.featureDecoder[features * l + j];
        if (b !== 0) for (let j = 0; j < width; j++) floats.local[o + j] += b * weights.offsetDecoder[width * l + j];
      }
      for (let j = 0; j < 6; j++) {
        const log = level.scaling[6 * r + j] * header.scalingSteps[j];
        const size = Math.exp(Math.min(Math.max(log, -MAX_LOG_SCALE), MAX_LOG_SCALE));
        if (j >= 3) floats.size[3 * r + j - 3] = size;
        else for (let k = 0; k < slots; k++) floats.local[o + 3 * k + j] *= size;
      }
    }
  }

  /**
   * Give the rows of `number` from `first` on their place among the splats.
   * @param {number} number
   * @param {number} first
   */
  admit(number, first) {
    const count = this.scene.levels[number].count,
      floats = this.levels[number];
    floats.reserve(count);
    for (let r = first; r < count; r++) floats.base[r] = this.anchors++;
    const rows = Math.ceil((this.anchors * this.slots) / ROW_SPLATS);
    const size = rows * ROW_SPLATS * RECORD;
    if (this.splats.length < size) {
      const larger = new Uint32Array(this.splats.length ? roundUp(size * 1.25, ROW_SPLATS * RECORD) : size);
      larger.set(this.splats);
      this.splats = larger;
      this.numbers = new Float32Array(larger.buffer);
    }
  }

  /**
   * Write the splats of `rows` of a level as seen from `viewpoint`.
   * @param {number} number - level
   * @param {ArrayLike<number>} rows
   * @param {ArrayLike<number>} viewpoint - 3 world coordinates
   */
  write(number, rows, viewpoint) {
    const alive = this.scene.levels[number].alive;
    const batch = new Uint32Array(BATCH);
    let filled = 0;
    for (let i = 0; i < rows.length; i++) {
      if (alive[rows[i]]) batch[filled++] = rows[i];
      else this.#hide(this.levels[number].base[rows[i]]);
      if (filled === BATCH || (i === rows.length - 1 && filled)) {
        this.#infer(this.levels[number], batch, filled, viewpoint);
        this.#pack(this.levels[number], batch, filled);
        filled = 0;
      }
    }
  }

  /** @param {number} anchor */
  #hide(anchor) {
    const first = anchor * this.slots;
    for (let s = first; s < first + this.slots; s++) this.numbers[s * RECORD + 3] = 0;
    this.#mark(first);
  }

  /** @param {number} first splat of an anchor */
  #mark(first) {
    this.dirty.add(Math.floor(first / ROW_SPLATS));
    this.dirty.add(Math.floor((first + this.slots - 1) / ROW_SPLATS));
  }

  /** @type {(floats: LevelFloats, rows: Uint32Array, count: number, viewpoint: ArrayLike<number>) => void} */
  #infer({ feature, anchor }, rows, count, viewpoint) {
    const { x, inputs, features, kernel, pointers, columns } = this;
    const { viewDependent, referenceDistance } = this.scene.header;
    for (let i = 0; i < count; i++) {
      const r = rows[i],
        o = i * inputs;
      for (let j = 0, f = r * features; j < features; j++) x[o + j] = feature[f + j];
      if (viewDependent) {
        const dx = anchor[3 * r] - viewpoint[0],
          dy = anchor[3 * r + 1] - viewpoint[1],
          dz = anchor[3 * r + 2] - viewpoint[2];
        const distance = Math.max(Math.sqrt(dx * dx + dy * dy + dz * dz), 1e-12);
        x[o + features] = dx / distance;
        x[o + features + 1] = dy / distance;
        x[o + features + 2] = dz / distance;
        x[o + features + 3] = distance / referenceDistance;
      }
    }
    const pairs = (count + 1) >> 1; // an odd batch computes one row more, which nobody reads
    kernel.dense(pairs, pointers[4], inputs, pointers[0], pointers[1], pointers[5], HIDDEN / 16, 1);
    kernel.dense(pairs, pointers[5], HIDDEN, pointers[2], pointers[3], pointers[6], columns / 16, 0);
    kernel.sigmoid(pointers[6], count, 4 * columns, Math.ceil((7 * this.slots) / 4));
  }

  /** @type {(floats: LevelFloats, rows: Uint32Array, count: number) => void} */
  #pack({ base, anchor, local, size }, rows, count) {
    const { y, columns, slots, numbers, splats, rotations } = this;
    for (let i = 0; i < count; i++) {
      const r = rows[i],
        first = base[r] * slots,
        out = i * columns;
      const ax = anchor[3 * r],
        ay = anchor[3 * r + 1],
        az = anchor[3 * r + 2];
      const sx = size[3 * r],
        sy = size[3 * r + 1],
        sz = size[3 * r + 2];
      for (let k = 0; k < slots; k++) {
        const o = (first + k) * RECORD;
        const opacity = 2 * y[out + k] - 1;
        if (!(opacity >= MIN_ALPHA)) {
          numbers[o + 3] = 0;
          continue;
        }
        const l = 3 * (r * slots + k),
          c = out + slots + 3 * k,
          s = out + 4 * slots + 3 * k,
          q = out + rotations + 4 * k;
        let qw = y[q],
          qx = y[q + 1],
          qy = y[q + 2],
          qz = y[q + 3];
        const length = Math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz),
          n = 1 / length;
        qw *= n;
        qx *= n;
        qy *= n;
        qz *= n;
        const a = y[s] * sx,
          b = y[s + 1] * sy,
          d = y[s + 2] * sz;
        // Columns of rotation x diag(scale); the covariance is their outer sum.
        const m0 = (1 - 2 * (qy * qy + qz * qz)) * a,
          m1 = 2 * (qx * qy + qw * qz) * a,
          m2 = 2 * (qx * qz - qw * qy) * a;
        const m3 = 2 * (qx * qy - qw * qz) * b,
          m4 = (1 - 2 * (qx * qx + qz * qz)) * b,
          m5 = 2 * (qy * qz + qw * qx) * b;
        const m6 = 2 * (qx * qz + qw * qy) * d,
          m7 = 2 * (qy * qz - qw * qx) * d,
          m8 = (1 - 2 * (qx * qx + qy * qy)) * d;
        numbers[o] = ax + local[l];
        numbers[o + 1] = ay + local[l + 1];
        numbers[o + 2] = az + local[l + 2];
        numbers[o + 3] = opacity;
        numbers[o + 4] = m0 * m0 + m3 * m3 + m6 * m6;
        numbers[o + 5] = m0 * m1 + m3 * m4 + m6 * m7;
        numbers[o + 6] = m0 * m2 + m3 * m5 + m6 * m8;
        numbers[o + 7] = m1 * m1 + m4 * m4 + m7 * m7;
        numbers[o + 8] = m1 * m2 + m4 * m5 + m7 * m8;
        numbers[o + 9] = m2 * m2 + m5 * m5 + m8 * m8;
        let sum = 0; // of finite float32 numbers it is finite, too
        for (let j = 0; j < 10; j++) sum += numbers[o + j];
        if (!Number.isFinite(sum) || !(length >= MIN_LENGTH && length <= MAX_LENGTH)) {
          numbers[o + 3] = 0;
          continue;
        }
        splats[o + 10] = (y[c] * 65535 + 0.5) | ((y[c + 1] * 65535 + 0.5) << 16);
        splats[o + 11] = y[c + 2] * 65535 + 0.5;
      }
      this.#mark(first);
    }
  }

  /** Texture rows written since the last call, ascending. @returns {number[]} */
  takeDirty() {
    const rows = [...this.dirty].sort((a, b) => a - b);
    this.dirty.clear();
    return rows;
  }
}
