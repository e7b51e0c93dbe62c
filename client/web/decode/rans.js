/** The range coder's decoder: integers only, codec/FORMAT.md section 6.2 and 6.3. */

import { must } from "./packet.js";
import { bin, SCALE, STEPS } from "./tables.js";

const FINAL = 65536;
const ESCAPE = 16,
  TOP_BIN = 30;

/** Adaptive models of one bit. */
export class BitModels {
  /** @param {number} count */
  constructor(count) {
    this.zeros = new Uint16Array(count).fill(1);
    this.ones = new Uint16Array(count).fill(1);
  }
}

export class RansDecoder {
  /** @param {Uint8Array} bytes - the words @param {number} lanes - 1 or 4 */
  constructor(bytes, lanes) {
    must(bytes.length % 2 === 0 && bytes.length >= 4 * lanes);
    this.words = new Uint16Array(bytes.slice().buffer);
    this.mask = lanes - 1;
    this.state = new Uint32Array(lanes);
    for (let k = 0; k < lanes; k++) {
      this.state[k] = this.words[2 * k] | (this.words[2 * k + 1] << 16);
      must(this.state[k] >= FINAL);
    }
    this.at = 2 * lanes;
    this.lane = 0;
  }

  /** @type {(lane: number, frequency: number, rest: number) => void} consume an interval; rest = slot - start */
  #advance(lane, frequency, rest) {
    let x = (Math.imul(frequency, this.state[lane] >>> 12) + rest) >>> 0;
    if (x < FINAL) {
      must(this.at < this.words.length);
      x = ((x << 16) | this.words[this.at++]) >>> 0;
    }
    this.state[lane] = x;
    this.lane = (lane + 1) & this.mask;
  }

  /** @param {number} width - 1 to 12 @returns {number} */
  bits(width) {
    const { lane } = this,
      slot = this.state[lane] & 4095,
      shift = 12 - width;
    this.#advance(lane, 1 << shift, slot & ((1 << shift) - 1));
    return slot >>> shift;
  }

  /** @param {number} width - 0 to 30 @returns {number} */
  raw(width) {
    let value = 0;
    for (let shift = 0; shift < width; shift += 12) value |= this.bits(Math.min(width - shift, 12)) << shift;
    return value;
  }

  /** @param {BitModels} models @param {number} i @returns {number} 0 or 1 */
  flag({ zeros, ones }, i) {
    let n0 = zeros[i],
      n1 = ones[i];
    const split = Math.min(Math.max(Math.trunc((4096 * n0) / (n0 + n1)), 1), 4095);
    const { lane } = this,
      slot = this.state[lane] & 4095;
    const bit = slot < split ? 0 : 1;
    if (bit) {
      this.#advance(lane, 4096 - split, slot - split);
      n1 += 2;
    } else {
      this.#advance(lane, split, slot);
      n0 += 2;
    }
    if (n0 + n1 > 1020) {
      n0 = (n0 + 1) >> 1;
      n1 = (n1 + 1) >> 1;
    }
    zeros[i] = n0;
    ones[i] = n1;
    return bit;
  }

  /** A signed integer by the frozen table of bin `b`. @param {number} b @returns {number} */
  value(b) {
    let s = 0;
    if (b < 0) b = 0;
    else if (b > TOP_BIN) {
      b = Math.min(b, 120);
      s = (b - 27) >> 2;
      b -= 4 * s;
    }
    const { lane } = this,
      step = STEPS[(b << 12) | (this.state[lane] & 4095)];
    let z = step >>> 25;
    this.#advance(lane, (step >>> 12) & 8191, step & 4095);
    if (z === ESCAPE) {
      let width = 0;
      while (this.bits(1)) must(++width <= 30);
      z = 15 + 2 ** width + this.raw(width);
    }
    let result = z & 1 ? -(z + 1) / 2 : z / 2;
    if (s) result = result * (1 << s) - (1 << (s - 1)) + (s <= 12 ? this.bits(s) : this.raw(s));
    must(result < 1073741824 && result > -1073741824);
    return result;
  }

  /** All must be used up. */
  end() {
    must(this.at === this.words.length && this.state.every((x) => x === FINAL));
  }
}

/** @typedef {{ magnitude: Int32Array, channels: number }} Scales */

/** Side fields of 6.3. @type {(reader: import("./packet.js").Reader, channels: number) => Scales} */
export function readScales(reader, channels) {
  const base = reader.u8();
  if (base >= SCALE.length)
    return { magnitude: new Int32Array(channels).fill(SCALE[base - SCALE.length + 16]), channels };
  const nibbles = reader.take(Math.ceil(channels / 2));
  const magnitude = new Int32Array(channels); // 0: not coded
  for (let c = 0; c < channels; c++) {
    const d = (nibbles[c >> 1] >> (4 * (c & 1))) & 15;
    if (d) magnitude[c] = scale(base + 4 * (d - 1));
  }
  must(channels % 2 === 0 || nibbles[channels >> 1] >> 4 === 0);
  return { magnitude, channels };
}

/** @type {(q: number) => number} */
export function scale(q) {
  must(q < SCALE.length);
  return SCALE[q];
}

/**
 * Rows of integers with energy context: those of one class, each to its place in `result`.
 * @type {(coder: RansDecoder, classes: Uint8Array, own: number, scales: Scales, result: Int32Array) => void}
 */
export function decodeClass(coder, classes, own, { magnitude, channels }, result) {
  const weight = new Int32Array(channels),
    share = new Int32Array(channels),
    bins = new Int32Array(channels);
  let total = 0;
  for (let c = 0; c < channels; c++) {
    const m = magnitude[c];
    if (!m) continue;
    weight[c] = Math.trunc(65536 / (256 + m));
    share[c] = Math.max(1, (weight[c] * m + 128) >> 8);
    bins[c] = bin(m);
    total += share[c];
  }
  if (!total) return;
  // The common case of `coder.value` is spelt out below on local variables: a symbol of its table, no escape.
  const { words, state, mask } = coder;
  let { at, lane } = coder,
    energy = total;
  for (let i = 0; i < classes.length; i++) {
    if (classes[i] !== own) continue;
    let t = 0,
      r = 0,
      g = 0,
      place = i * channels;
    for (let c = 0; c < channels; c++, place++) {
      if (!(c & 1)) g = bin(Math.floor((256 * (energy + 2 * t)) / (total + 2 * r))) - 24;
      if (!magnitude[c]) continue;
      const b = Math.max(bins[c] + g, 0);
      const step = b > TOP_BIN ? ESCAPE << 25 : STEPS[(b << 12) | (state[lane] & 4095)];
      const z = step >>> 25;
      let v = 0;
      if (z === ESCAPE) {
        coder.at = at;
        coder.lane = lane;
        v = coder.value(b);
        at = coder.at;
        lane = coder.lane;
      } else {
        let x = (Math.imul((step >>> 12) & 8191, state[lane] >>> 12) + (step & 4095)) >>> 0;
        if (x < FINAL) {
          if (at === words.length) must(false);
          x = ((x << 16) | words[at++]) >>> 0;
        }
        state[lane] = x;
        lane = (lane + 1) & mask;
        v = z & 1 ? -((z + 1) >> 1) : z >> 1;
      }
      if (v) {
        result[place] = v;
        t += weight[c] * Math.min(v < 0 ? -v : v, 65535);
      }
      r += share[c];
    }
    energy += Math.floor((t - energy) / 8);
  }
  coder.at = at;
  coder.lane = lane;
}
