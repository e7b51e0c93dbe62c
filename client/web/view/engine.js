/** From packets and a view to splats in drawing order. */

import { RECORD, ROW_SPLATS } from "../decode/expand.js";
import { Gaussians } from "../lib/gaussians.js";
import { nearRadius } from "./limits.js";
import { DepthSort } from "./sort.js";
import { anchorCount, versionOf } from "../decode/scene.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */

/**
 * @typedef {object} EngineView
 * @property {Vec3} position
 * @property {number[]} rotation - 9 numbers, world to camera
 * @property {number} levels - levels wanted, coarse ones first
 * @property {boolean} [unsorted] - the renderer sorts by itself
 */

/**
 * What the renderer needs next.
 * @typedef {object} Picture
 * @property {number} generation - grows when the texture must be made anew, as with each keyframe
 * @property {number} rows - of the texture
 * @property {{ first: number, data: Uint32Array }[]} spans - texture rows that changed
 * @property {Uint32Array | null} order - splat numbers, far ones first; unsorted, null where they are those of the picture before
 * @property {number} splats
 * @property {number} [anchors] - alive
 * @property {number} version
 * @property {number} missing - finest levels of the scene that are not there
 * @property {number} expandMs
 * @property {number} sortMs
 */

const ROW_NUMBERS = ROW_SPLATS * RECORD;
const JOIN = 2; // texture rows between two spans that are sent along rather than sent apart

export class Engine extends Gaussians {
  /** @param {import("../decode/expand.js").Kernel} kernel */
  constructor(kernel) {
    super(kernel);
    this.sorter = new DepthSort();
    this.generation = 0;
    this.capacity = 0;
    this.told = 0; // times that `active` had changed when it was told
  }

  /** Decode one packet. @param {Uint8Array} bytes @returns {import("../decode/decoder.js").Effect} */
  push(bytes) {
    const { expander } = this,
      effect = super.push(bytes);
    if (this.expander !== expander) this.capacity = 0;
    return effect;
  }

  /**
   * Bring the splats up to date and sort them for `view`.
   * @param {EngineView} view
   * @returns {Picture | null} null before the first keyframe
   */
  picture(view) {
    const { scene } = this;
    if (!scene || !this.expander) return null;
    const start = performance.now();
    this.update(view.position, view.levels);
    const spans = this.#spans();
    const sorted = performance.now();
    const order = view.unsorted ? this.#changed() : this.#order(view);
    return {
      generation: this.generation,
      rows: this.capacity,
      spans,
      order,
      splats: order?.length ?? this.activeCount,
      anchors: anchorCount(scene),
      version: versionOf(scene),
      missing: Math.clz32(this.visible) - Math.clz32((1 << scene.levels.length) - 1),
      expandMs: sorted - start,
      sortMs: performance.now() - sorted,
    };
  }

  /** Changed texture rows as copies, all of them when the texture grows. */
  #spans() {
    const expander = /** @type {import("../decode/expand.js").Expander} */ (this.expander);
    const capacity = expander.splats.length / ROW_NUMBERS;
    const dirty = expander.takeDirty();
    if (capacity !== this.capacity) {
      this.capacity = capacity;
      this.generation++;
      return [{ first: 0, data: expander.splats.slice() }];
    }
    const spans = [];
    for (let i = 0; i < dirty.length;) {
      let j = i + 1;
      while (j < dirty.length && dirty[j] - dirty[j - 1] <= JOIN) j++;
      spans.push({
        first: dirty[i],
        data: expander.splats.slice(dirty[i] * ROW_NUMBERS, (dirty[j - 1] + 1) * ROW_NUMBERS),
      });
      i = j;
    }
    return spans;
  }

  /** After the graphics card lost the texture. */
  forgetTexture() {
    this.capacity = this.told = 0;
  }

  /** @param {Vec3} position */
  #near(position) {
    return nearRadius(position, this.scene?.header.cameras ?? []);
  }

  /** The splats worth drawing, level by level; null where they were told already. */
  #changed() {
    if (this.told === this.collected) return null;
    this.told = this.collected;
    return this.active.slice(0, this.activeCount);
  }

  /** @param {EngineView} view */
  #order({ rotation, position }) {
    const numbers = /** @type {import("../decode/expand.js").Expander} */ (this.expander).numbers;
    return this.sorter
      .order(numbers, RECORD, this.active, this.activeCount, rotation.slice(6), position, this.#near(position))
      .slice();
  }

  /**
   * The first clearly visible splat along a ray.
   * @param {Vec3} origin
   * @param {Vec3} direction - of unit length
   * @returns {Vec3 | null}
   */
  pick(origin, [a, b, c]) {
    if (!this.expander) return null;
    const { numbers } = this.expander;
    const near = this.#near(origin);
    let best = Infinity;
    for (let i = 0; i < this.activeCount; i++) {
      const o = this.active[i] * RECORD;
      if (numbers[o + 3] < 0.2) continue;
      const x = numbers[o] - origin[0],
        y = numbers[o + 1] - origin[1],
        z = numbers[o + 2] - origin[2];
      const depth = a * x + b * y + c * z,
        away = x * x + y * y + z * z;
      if (depth <= 0.02 || depth >= best || away < near * near) continue;
      const xx = numbers[o + 4],
        yy = numbers[o + 7],
        zz = numbers[o + 9];
      if (away - depth * depth >= Math.max(2 * xx, 2 * yy, 2 * zz, (0.004 * depth) ** 2)) continue;
      const mixed = a * b * numbers[o + 5] + a * c * numbers[o + 6] + b * c * numbers[o + 8];
      if (4 * (a * a * xx + b * b * yy + c * c * zz + 2 * mixed) <= depth * depth) best = depth; // else left out
    }
    return best < Infinity ? [origin[0] + best * a, origin[1] + best * b, origin[2] + best * c] : null;
  }

  /**
   * Median depth of the anchors near a camera's axis: what it looks at.
   * @type {(origin: Vec3, forward: Vec3) => number}
   */
  depthAlong(origin, forward) {
    const depths = [];
    const { scene, expander } = this;
    for (const [l, { anchor }] of (expander?.levels ?? []).entries()) {
      for (let i = 0; i < (scene?.levels[l].count ?? 0); i++) {
        const x = anchor[3 * i] - origin[0],
          y = anchor[3 * i + 1] - origin[1],
          z = anchor[3 * i + 2] - origin[2];
        const depth = x * forward[0] + y * forward[1] + z * forward[2];
        if (depth > 0 && x * x + y * y + z * z < 1.1 * depth * depth) depths.push(depth);
      }
    }
    depths.sort((a, b) => a - b);
    return depths.length ? depths[depths.length >> 1] : 0;
  }
}
