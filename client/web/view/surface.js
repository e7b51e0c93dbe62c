/** A canvas that shows a scene: what all ways to draw have in common, and what each of them has to offer. */

import { NEUTRAL } from "./exposure.js";

export const MAX_KEEP = 1.5; // times the share, in the middle and near; at most all
export const MIN_KEEP = 0.03; // a share below would make splats too large to tell anything apart
export const MAX_BLUR = 0.05; // of what the lens shows out of focus, as a fraction of the focal length
const SPREAD = 2; // area that coarser splats cover for each level that is missing

const CORNERS = [0, 1, 2, 2, 1, 3]; // of a quad's two triangles

/** The vertices of so many quads, six a quad: vertex number = 4 x quad + corner. @param {number} quads */
export const quadVertices = (quads) =>
  Uint16Array.from({ length: 6 * quads }, (_, i) => 4 * Math.trunc(i / 6) + CORNERS[i % 6]);

/**
 * @typedef {object} View
 * @property {ArrayLike<number>} rotation - 9 numbers, row by row, world to camera
 * @property {ArrayLike<number>} translation - 3
 * @property {[number, number]} focal - pixels
 * @property {[number, number]} principal - pixels
 * @property {number} [share] - of the splats that are drawn where it matters least to leave some out; 1: all
 * @property {number} [range] - distance up to which splats count as near, and at which they are sharp
 * @property {number} [lens] - its radius, world units; 0: everything is sharp
 * @property {number} [near] - distance from the eye within which nothing is drawn
 * @property {import("./exposure.js").Exposure} [exposure] - neutral where none is given
 */

export class Surface {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.api = "none"; // what draws, in a word
    this.hardware = ""; // its name, "" where the browser hides it
    this.sorts = false; // takes splats in any order
    /** @type {Promise<unknown> | null} settled once nothing can be drawn with it any more */
    this.ends = null;
    this.movesFrom = this.movesFor = 0; // ms: since when it moves on from the state before, and for how long
    this.moved = 1; // share of the way that is drawn
    this.rows = 0; // of splats, for which there is room
    this.missing = 0; // finest levels of the scene that are not there
    /** @type {[number, number, number]} */
    this.background = [0, 0, 0];
    /** @type {[number, number, number] | null} shown instead of it */
    this.backdrop = null;
  }

  /** Whether the browser took the graphics card away. */
  get isLost() {
    return false;
  }

  /** How many pictures are still being drawn. Beyond one, the page would stand still for the graphics card. */
  get waiting() {
    return 0;
  }

  /** Area that each splat has to cover, in areas of its own; 1 where no level is missing. */
  get spread() {
    return SPREAD ** this.missing;
  }

  /** The colour behind the splats. @param {View} view */
  behind({ exposure = NEUTRAL }) {
    return this.backdrop ?? this.background.map((colour, i) => exposure[i] * colour + exposure[i + 3]);
  }

  /** Move on from the state before, which is shown now. @param {number} overMs */
  begin(overMs) {
    this.movesFrom = performance.now();
    this.movesFor = overMs;
  }

  /** Go as far as the time says. */
  advance() {
    const age = performance.now() - this.movesFrom;
    this.moved = age < this.movesFor ? age / this.movesFor : 1;
  }

  /**
   * Take new rows of splats; a scene of another size starts afresh.
   * @param {number} rows - of the whole scene
   * @param {{ first: number, data: Uint32Array }[]} spans - `first` row and whole rows of splats
   * @param {number | null} [overMs] - to move on from the state before; null: it is the same state
   */
  update(rows, spans, overMs = null) {}

  /** The splats to draw. @param {Uint32Array} order - their numbers, far ones first unless it sorts */
  setOrder(order) {}

  /** Another scene follows, which may be smaller. */
  clear() {
    this.rows = 0;
    this.setOrder(new Uint32Array(0));
  }

  /** @param {View} view */
  draw(view) {}

  /** Free everything on the graphics card. */
  destroy() {}
}
