/** From packets and a view to splats in drawing order. */

import { SceneDecoder } from "../decode/decoder.js";
import { Expander, MIN_ALPHA, RECORD, ROW_SPLATS } from "../decode/expand.js";
import { add, distanceTo } from "./camera.js";
import { DepthSort, fillQuads } from "./sort.js";
import { anchorCount, versionOf } from "../decode/scene.js";

/** @typedef {import("../decode/scene.js").Scene} Scene */
/** @typedef {import("./camera.js").Vec3} Vec3 */

/**
 * @typedef {object} EngineView
 * @property {Vec3} position
 * @property {number[]} rotation - 9 numbers, world to camera
 * @property {number} levels - levels wanted, coarse ones first
 */

/**
 * What the renderer needs next.
 * @typedef {object} Picture
 * @property {number} generation - grows when the texture must be made anew, as with each keyframe
 * @property {number} rows - of the texture
 * @property {{ first: number, data: Uint32Array }[]} spans - texture rows that changed
 * @property {Uint32Array} quads
 * @property {number} splats
 * @property {number} [anchors] - alive
 * @property {number} version
 * @property {number} missing - finest levels of the scene that are not there
 * @property {number} expandMs
 * @property {number} sortMs
 */

const TURN = 0.02; // view-dependent anchors are expanded again after moves beyond this fraction of the distance to them
const NEAR_SHARE = 0.15; // of the distance to the nearest camera
const ROW_NUMBERS = ROW_SPLATS * RECORD;
const JOIN = 2; // texture rows between two spans that are sent along rather than sent apart

export class Engine {
  /** @param {import("../decode/expand.js").Kernel} kernel */
  constructor(kernel) {
    this.kernel = kernel;
    this.decoder = new SceneDecoder();
    /** @type {Expander | null} */
    this.expander = null;
    /** @type {Map<number, Uint8Array>} rows to expand, by level */
    this.pending = new Map();
    this.fresh = true; // nothing of this scene was expanded yet
    this.active = new Uint32Array(0);
    this.activeCount = 0;
    this.sorter = new DepthSort();
    this.generation = 0;
    this.capacity = 0;
    this.visible = 0; // bit mask of levels in `active`
    /** @type {Vec3} */
    this.expandedFrom = [Infinity, 0, 0];
    this.centre = /** @type {Vec3} */ ([0, 0, 0]);
  }

  get scene() {
    return this.decoder.scene;
  }

  /** Decode one packet. @param {Uint8Array} bytes @returns {import("../decode/decoder.js").Effect} */
  push(bytes) {
    const effect = this.decoder.push(bytes);
    const scene = /** @type {Scene} */ (this.scene);
    const replaced = effect.levels.some(({ rows }) => rows === null);
    if (!this.expander || replaced) {
      // A keyframe, or a part of one: anchors are numbered anew.
      this.expander = new Expander(scene, this.kernel);
      this.capacity = 0;
      this.pending.clear();
      for (let level = 0; level < scene.levels.length; level++) this.#admit(level, 0);
      this.fresh = true;
      return effect;
    }
    this.expander.scene = scene;
    for (const { level, rows, from } of effect.levels) {
      this.#admit(level, from);
      const marks = /** @type {Uint8Array} */ (this.pending.get(level));
      if (rows) for (let i = 0; i < rows.length; i++) marks[rows[i]] = 1;
    }
    return effect;
  }

  /** Mark rows from `from` on as new. @param {number} number @param {number} from */
  #admit(number, from) {
    const scene = /** @type {Scene} */ (this.scene), expander = /** @type {Expander} */ (this.expander);
    const count = scene.levels[number].count;
    const old = this.pending.get(number);
    if (!old || old.length < count) {
      const marks = new Uint8Array(count);
      if (old) marks.set(old);
      this.pending.set(number, marks);
    }
    if (from >= count) return;
    /** @type {Uint8Array} */ (this.pending.get(number)).fill(1, from);
    expander.admit(number, from);
  }

  /**
   * Bring the splats up to date and sort them for `view`.
   * @param {EngineView} view
   * @returns {Picture | null} null before the first keyframe
   */
  picture(view) {
    const { scene, expander } = this;
    if (!scene || !expander) return null;
    const start = performance.now();
    const newest = versionOf(scene);
    let visible = 0;
    for (let l = 0; l < Math.min(view.levels, scene.levels.length); l++) if (scene.versions[l] === newest) visible |= 1 << l;
    const everything = this.#moved(view.position) || (scene.header.viewDependent && visible !== this.visible);
    let changed = this.fresh || visible !== this.visible;
    for (let l = 0; l < scene.levels.length; l++) {
      const rows = this.#takePending(l);
      if (rows.length) {
        expander.refresh(l, rows);
        changed = true;
      }
      const wanted = everything && (visible >> l) & 1 ? range(scene.levels[l].count) : rows;
      if (wanted.length) expander.write(l, wanted, view.position);
    }
    if (everything) this.expandedFrom = view.position;
    if (this.fresh) this.centre = middle(scene, expander);
    this.visible = visible;
    this.fresh = false;
    if (changed || everything) this.#collect(visible);
    const spans = this.#spans();
    const sorted = performance.now();
    const quads = this.#order(view);
    return {
      generation: this.generation, rows: this.capacity, spans, quads, splats: quads.length / 6, anchors: anchorCount(scene), version: newest,
      missing: Math.clz32(visible) - Math.clz32((1 << scene.levels.length) - 1),
      expandMs: sorted - start, sortMs: performance.now() - sorted,
    };
  }

  /** @param {Vec3} position */
  #moved(position) {
    const { scene } = this;
    if (!scene?.header.viewDependent) return false;
    const [moved, reach] = [this.expandedFrom, this.centre].map((place) => Math.hypot(...add(position, place, -1)));
    return this.fresh || !(moved <= TURN * reach);
  }

  /** @param {number} level @returns {Uint32Array} */
  #takePending(level) {
    const marks = this.pending.get(level);
    if (!marks) return new Uint32Array(0);
    const rows = [];
    for (let i = 0; i < marks.length; i++) if (marks[i]) rows.push(i);
    if (rows.length) marks.fill(0);
    return Uint32Array.from(rows);
  }

  /** Splats worth drawing, level by level. @param {number} visible */
  #collect(visible) {
    const scene = /** @type {Scene} */ (this.scene), expander = /** @type {Expander} */ (this.expander);
    const { numbers, slots } = expander;
    if (this.active.length < expander.anchors * slots) this.active = new Uint32Array(expander.anchors * slots);
    let count = 0;
    scene.levels.forEach((level, l) => {
      if (!((visible >> l) & 1)) return;
      const { base } = expander.levels[l];
      for (let r = 0; r < level.count; r++) {
        for (let s = base[r] * slots, end = s + slots; s < end; s++) {
          if (numbers[s * RECORD + 3] >= MIN_ALPHA) this.active[count++] = s;
        }
      }
    });
    this.activeCount = count;
  }

  /** Changed texture rows as copies, all of them when the texture grows. */
  #spans() {
    const expander = /** @type {Expander} */ (this.expander);
    const capacity = expander.splats.length / ROW_NUMBERS;
    const dirty = expander.takeDirty();
    if (capacity !== this.capacity) {
      this.capacity = capacity;
      this.generation++;
      return [{ first: 0, data: expander.splats.slice() }];
    }
    const spans = [];
    for (let i = 0; i < dirty.length; ) {
      let j = i + 1;
      while (j < dirty.length && dirty[j] - dirty[j - 1] <= JOIN) j++;
      spans.push({ first: dirty[i], data: expander.splats.slice(dirty[i] * ROW_NUMBERS, (dirty[j - 1] + 1) * ROW_NUMBERS) });
      i = j;
    }
    return spans;
  }

  /** After the graphics card lost the texture. */
  forgetTexture() {
    this.capacity = 0;
  }

  /** Nothing is drawn within this distance of there (`near_radius` in core/scene/expand.py). @param {Vec3} position */
  #near(position) {
    const away = this.scene?.header.cameras.map((camera) => distanceTo(position, camera));
    return away?.length ? NEAR_SHARE * Math.min(...away) : 0;
  }

  /** @param {EngineView} view */
  #order({ rotation, position }) {
    const numbers = /** @type {Expander} */ (this.expander).numbers;
    const order = this.sorter.order(numbers, RECORD, this.active, this.activeCount, rotation.slice(6), position, this.#near(position));
    const quads = new Uint32Array(6 * order.length);
    fillQuads(order, quads);
    return quads;
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
      const x = numbers[o] - origin[0], y = numbers[o + 1] - origin[1], z = numbers[o + 2] - origin[2];
      const depth = a * x + b * y + c * z, away = x * x + y * y + z * z;
      if (depth <= 0.02 || depth >= best || away < near * near) continue;
      const xx = numbers[o + 4], yy = numbers[o + 7], zz = numbers[o + 9];
      if (away - depth * depth >= Math.max(2 * xx, 2 * yy, 2 * zz, (0.004 * depth) ** 2)) continue;
      const mixed = a * b * numbers[o + 5] + a * c * numbers[o + 6] + b * c * numbers[o + 8];
      if (4 * (a * a * xx + b * b * yy + c * c * zz + 2 * mixed) <= depth * depth) best = depth; // else left out
    }
    return best < Infinity ? [origin[0] + best * a, origin[1] + best * b, origin[2] + best * c] : null;
  }

  /** Median depth of the anchors near a camera's axis: what it looks at. @type {(origin: Vec3, forward: Vec3) => number} */
  depthAlong(origin, forward) {
    const depths = [];
    const { scene, expander } = this;
    for (const [l, { anchor }] of (expander?.levels ?? []).entries()) {
      for (let i = 0; i < (scene?.levels[l].count ?? 0); i++) {
        const x = anchor[3 * i] - origin[0], y = anchor[3 * i + 1] - origin[1], z = anchor[3 * i + 2] - origin[2];
        const depth = x * forward[0] + y * forward[1] + z * forward[2];
        if (depth > 0 && x * x + y * y + z * z < 1.1 * depth * depth) depths.push(depth);
      }
    }
    depths.sort((a, b) => a - b);
    return depths.length ? depths[depths.length >> 1] : 0;
  }
}

/** @type {(count: number) => Uint32Array} */
const range = (count) => Uint32Array.from({ length: count }, (_, i) => i);

/** Mean of all anchors. @type {(scene: Scene, expander: Expander) => Vec3} */
function middle(scene, expander) {
  /** @type {Vec3} */
  const sum = [0, 0, 0];
  let count = 0;
  expander.levels.forEach(({ anchor }, l) => {
    count += scene.levels[l].count;
    for (let i = 0; i < 3 * scene.levels[l].count; i++) sum[i % 3] += anchor[i];
  });
  return add([0, 0, 0], sum, 1 / (count || 1));
}
