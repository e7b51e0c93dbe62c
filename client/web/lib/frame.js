/** Gaussians as typed arrays, one for each quantity, in which a place keeps its Gaussian until the next keyframe. */

import { MIN_ALPHA, RECORD, ROW_SPLATS } from "../decode/expand.js";

/**
 * What is to be drawn at one moment. The arrays belong to the reader and are changed by the next frame.
 * @typedef {object} Frame
 * @property {number} seconds - since the begin of the recording; of live streams, since the first frame
 * @property {number} filmedMs - capture time, in the cameras' time
 * @property {number} version
 * @property {number} count - N, places; those with opacity 0 are empty
 * @property {Float32Array} positions - [N, 3] world units
 * @property {Float32Array} covariances - [N, 6] xx xy xz yy yz zz, world units squared
 * @property {Float32Array} opacities - [N] 0 to 1
 * @property {Float32Array} colors - [N, 3] sRGB, 0 to 1
 * @property {{ first: number, count: number }[]} changes - places that may differ from the frame before
 * @property {boolean} isNew - all of it is: a keyframe, or the first frame
 */

export class Columns {
  constructor() {
    this.room = 0;
    this.count = 0;
    this.positions = this.covariances = this.opacities = this.colors = new Float32Array(0);
    /** @type {object | null} whose places these are */
    this.owner = null;
    this.visible = 0; // bit mask of levels
  }

  /**
   * Take over what changed.
   * @param {import("./gaussians.js").Gaussians} gaussians
   * @returns {Pick<Frame, "count" | "positions" | "covariances" | "opacities" | "colors" | "changes" | "isNew">}
   */
  take({ expander, scene, visible }) {
    if (!expander || !scene) throw new Error("there is no keyframe yet");
    const count = expander.anchors * expander.slots,
      isNew = this.owner !== expander,
      rows = expander.takeDirty();
    if (this.room < count) {
      this.room = Math.ceil(count * 1.25);
      for (const [name, width] of /** @type {["positions" | "covariances" | "opacities" | "colors", number][]} */ ([
        ["positions", 3],
        ["covariances", 6],
        ["opacities", 1],
        ["colors", 3],
      ])) {
        const larger = new Float32Array(width * this.room);
        larger.set(this[name].subarray(0, width * this.count));
        this[name] = larger;
      }
    }
    const changes = isNew || visible !== this.visible ? [{ first: 0, count }] : spans(rows, count);
    this.owner = expander;
    this.visible = visible;
    this.count = count;
    for (const { first, count: length } of changes) this.#unpack(expander, first, first + length);
    scene.levels.forEach((level, l) => {
      // levels that lag behind are not shown
      if ((visible >> l) & 1) return;
      const { base } = expander.levels[l];
      for (let r = 0; r < level.count; r++)
        this.opacities.fill(0, base[r] * expander.slots, (base[r] + 1) * expander.slots);
    });
    return {
      count,
      changes,
      isNew,
      positions: this.positions.subarray(0, 3 * count),
      covariances: this.covariances.subarray(0, 6 * count),
      opacities: this.opacities.subarray(0, count),
      colors: this.colors.subarray(0, 3 * count),
    };
  }

  /** @param {import("../decode/expand.js").Expander} expander @param {number} from @param {number} to */
  #unpack({ numbers, splats }, from, to) {
    const { positions, covariances, opacities, colors } = this;
    for (let i = from, o = from * RECORD; i < to; i++, o += RECORD) {
      const opacity = numbers[o + 3];
      if (!(opacity >= MIN_ALPHA)) {
        opacities[i] = 0;
        continue;
      }
      opacities[i] = Math.min(opacity, 1);
      for (let j = 0; j < 3; j++) positions[3 * i + j] = numbers[o + j];
      for (let j = 0; j < 6; j++) covariances[6 * i + j] = numbers[o + 4 + j];
      colors[3 * i] = (splats[o + 10] & 0xffff) / 0xffff;
      colors[3 * i + 1] = (splats[o + 10] >>> 16) / 0xffff;
      colors[3 * i + 2] = (splats[o + 11] & 0xffff) / 0xffff;
    }
  }
}

/**
 * Rows of ROW_SPLATS as ranges of places.
 * @type {(rows: number[], count: number) => { first: number, count: number }[]}
 */
function spans(rows, count) {
  /** @type {{ first: number, count: number }[]} */
  const found = [];
  for (const row of rows) {
    const first = row * ROW_SPLATS,
      length = Math.min(ROW_SPLATS, count - first),
      last = found[found.length - 1];
    if (length <= 0) continue;
    if (last && last.first + last.count === first) last.count += length;
    else found.push({ first, count: length });
  }
  return found;
}

/**
 * Standard deviations along three axes, and the rotation of these, of a covariance (cyclic Jacobi), for renderers that
 * take those.
 * @param {ArrayLike<number>} covariances - xx xy xz yy yz zz each
 * @param {number} i - which
 * @param {Float32Array | number[]} scales - 3 numbers are written
 * @param {Float32Array | number[]} rotation - a quaternion x y z w is written
 */
export function decompose(covariances, i, scales, rotation) {
  const o = 6 * i,
    a = [
      covariances[o],
      covariances[o + 1],
      covariances[o + 2],
      covariances[o + 1],
      covariances[o + 3],
      covariances[o + 4],
      covariances[o + 2],
      covariances[o + 4],
      covariances[o + 5],
    ];
  const v = [1, 0, 0, 0, 1, 0, 0, 0, 1]; // columns are axes
  const size = Math.abs(a[0]) + Math.abs(a[4]) + Math.abs(a[8]);
  for (let sweep = 0; sweep < 8 && Math.abs(a[1]) + Math.abs(a[2]) + Math.abs(a[5]) > 1e-9 * size; sweep++) {
    for (const [p, q] of [
      [0, 1],
      [0, 2],
      [1, 2],
    ]) {
      const off = a[3 * p + q];
      if (off === 0) continue;
      const theta = (a[4 * q] - a[4 * p]) / (2 * off),
        t = Math.sign(theta || 1) / (Math.abs(theta) + Math.hypot(theta, 1));
      const c = 1 / Math.hypot(t, 1),
        s = t * c;
      for (let k = 0; k < 3; k++) {
        // columns, of the matrix and of the axes
        for (const m of [a, v])
          [m[3 * k + p], m[3 * k + q]] = [c * m[3 * k + p] - s * m[3 * k + q], s * m[3 * k + p] + c * m[3 * k + q]];
      }
      for (let k = 0; k < 3; k++)
        [a[3 * p + k], a[3 * q + k]] = [c * a[3 * p + k] - s * a[3 * q + k], s * a[3 * p + k] + c * a[3 * q + k]];
    }
  }
  for (let k = 0; k < 3; k++) scales[k] = Math.sqrt(Math.max(a[4 * k], 0));
  const mirrored =
    v[0] * (v[4] * v[8] - v[5] * v[7]) - v[1] * (v[3] * v[8] - v[5] * v[6]) + v[2] * (v[3] * v[7] - v[4] * v[6]) < 0;
  if (mirrored) for (let k = 0; k < 3; k++) v[3 * k] = -v[3 * k];
  const [xx, yy, zz] = [v[0], v[4], v[8]],
    trace = xx + yy + zz;
  const parts = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + trace],
    most = parts.indexOf(Math.max(...parts)); // 4 x the square of each
  const n = 0.5 / Math.sqrt(parts[most]);
  const whole = [
    // 4 x the products with each part
    [parts[0], v[1] + v[3], v[2] + v[6], v[7] - v[5]],
    [v[1] + v[3], parts[1], v[5] + v[7], v[2] - v[6]],
    [v[2] + v[6], v[5] + v[7], parts[2], v[3] - v[1]],
    [v[7] - v[5], v[2] - v[6], v[3] - v[1], parts[3]],
  ][most];
  for (let k = 0; k < 4; k++) rotation[k] = whole[k] * n;
}
