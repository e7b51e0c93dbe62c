/** From packets to Gaussians as they are seen from somewhere; only what changed is expanded again. */

import { SceneDecoder } from "../decode/decoder.js";
import { Expander, MIN_ALPHA, RECORD } from "../decode/expand.js";
import { versionOf } from "../decode/scene.js";

/** @typedef {import("../decode/scene.js").Scene} Scene */
/** @typedef {import("./vectors.js").Vec3} Vec3 */

const TURN = 0.02; // view-dependent anchors are expanded again after moves beyond this fraction of the distance to them

export class Gaussians {
  /** @param {import("../decode/expand.js").Kernel} kernel */
  constructor(kernel) {
    this.kernel = kernel;
    this.decoder = new SceneDecoder();
    /** @type {Expander | null} holds the Gaussians, RECORD numbers each */
    this.expander = null;
    /** @type {Map<number, Uint8Array>} rows to expand, by level */
    this.pending = new Map();
    this.fresh = true; // nothing of this scene was expanded yet
    this.active = new Uint32Array(0); // numbers of the Gaussians to draw
    this.activeCount = 0;
    this.collected = 0; // times that they may have changed
    this.visible = 0; // bit mask of levels in `active`
    /** @type {Vec3} */
    this.expandedFrom = [Infinity, 0, 0];
    this.centre = /** @type {Vec3} */ ([0, 0, 0]);
  }

  get scene() {
    return this.decoder.scene;
  }

  /**
   * Decode one packet.
   * @param {Uint8Array} bytes
   * @returns {import("../decode/decoder.js").Effect} @throws {import("../decode/scene.js").BitstreamError}
   */
  push(bytes) {
    const effect = this.decoder.push(bytes);
    const scene = /** @type {Scene} */ (this.scene);
    const replaced = effect.levels.some(({ rows }) => rows === null);
    if (!this.expander || replaced) {
      // A keyframe, or a part of one: anchors are numbered anew.
      this.expander = new Expander(scene, this.kernel);
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
    const scene = /** @type {Scene} */ (this.scene),
      expander = /** @type {Expander} */ (this.expander);
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
   * Bring the Gaussians up to date, as they are seen from there.
   * @param {Vec3} position
   * @param {number} levels - wanted, coarse ones first
   */
  update(position, levels) {
    const scene = /** @type {Scene} */ (this.scene),
      expander = /** @type {Expander} */ (this.expander);
    const newest = versionOf(scene);
    let visible = 0;
    for (let l = 0; l < Math.min(levels, scene.levels.length); l++) if (scene.versions[l] === newest) visible |= 1 << l;
    const everything = this.#moved(position) || (scene.header.viewDependent && visible !== this.visible);
    let changed = this.fresh || visible !== this.visible;
    for (let l = 0; l < scene.levels.length; l++) {
      const rows = this.#takePending(l);
      if (rows.length) {
        expander.refresh(l, rows);
        changed = true;
      }
      const wanted = everything && (visible >> l) & 1 ? range(scene.levels[l].count) : rows;
      if (wanted.length) expander.write(l, wanted, position);
    }
    if (everything) this.expandedFrom = position;
    if (this.fresh) this.centre = middle(scene, expander);
    this.visible = visible;
    this.fresh = false;
    if (changed || everything) this.#collect(visible);
  }

  /** @param {Vec3} position */
  #moved(position) {
    const { scene } = this;
    if (!scene?.header.viewDependent) return false;
    const [moved, reach] = [this.expandedFrom, this.centre].map((place) =>
      Math.hypot(...position.map((x, i) => x - place[i])),
    );
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

  /** Those worth drawing, level by level. @param {number} visible */
  #collect(visible) {
    const scene = /** @type {Scene} */ (this.scene),
      expander = /** @type {Expander} */ (this.expander);
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
    this.collected++;
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
  return /** @type {Vec3} */ (sum.map((x) => x / (count || 1)));
}
