/** Auto, high or low: what is given up while things move, and how many levels are asked for. */

/** @typedef {"auto" | "high" | "low"} Name */

/** @type {{ name: Name, label: string, note: string }[]} */
export const QUALITIES = [
  { name: "auto", label: "Auto", note: "keeps it smooth" },
  { name: "high", label: "High", note: "everything, always" },
  { name: "low", label: "Low", note: "saves data" },
];
const SLOW_FPS = 15,
  FAST_FPS = 30;
const MAX_FRAME_MS = 70; // so that a drag is answered within 100 ms
const PATIENCE = 2,
  COURAGE = 8; // measurements in a row before a step down or up
const COOL_DOWN = 40; // heartbeats before a step that proved too slow is tried again

/** @typedef {{ resolution: number, share: number, warps?: boolean }} Step */

/**
 * What auto gives up while things move, little by little: shares of the screen's resolution and of the splats
 * (renderer.js). At last it draws rarely, and moves the last picture meanwhile (warp.js).
 */
/** @type {Step[]} */
const STEPS = [
  { resolution: 1, share: 1 },
  { resolution: 0.75, share: 1 },
  { resolution: 0.6, share: 0.7 },
  { resolution: 0.5, share: 0.5 },
  { resolution: 0.4, share: 0.4 },
  { resolution: 0.35, share: 0.3 },
  { resolution: 0.5, share: 0.3, warps: true },
];
/** @type {Record<Name, Step[]>} */
const CHOICES = { auto: STEPS, high: STEPS.slice(0, 1), low: STEPS.slice(1) };

export class Quality {
  /** @param {import("./viewer.js").Viewer} viewer @param {string | null} wanted */
  constructor(viewer, wanted) {
    this.viewer = viewer;
    this.total = 0; // levels of the stream
    this.step = 0;
    this.slow = 0;
    this.fast = 0;
    this.settling = 0; // frames to come that may still show what was before a step
    this.resting = 0; // heartbeats until a finer step may be tried
    /** @type {number | null} */
    this.asked = null; // levels, null: all
    /** @type {Name} */
    this.name = wanted === "high" || wanted === "low" ? wanted : "auto";
    this.#apply();
  }

  /** @param {Name} name */
  choose(name) {
    this.name = name;
    this.step = this.slow = this.fast = this.resting = 0;
    this.#apply();
  }

  /** Whether this device is too slow for any of it. */
  get isTooSlow() {
    return this.#now.warps === true;
  }

  /** How many levels the stream has. @param {number | null} levels */
  limit(levels) {
    if (!levels || levels === this.total) return;
    this.total = levels;
    this.#apply();
  }

  /** What to ask the server for. */
  wishes() {
    return { levels: this.asked };
  }

  /**
   * A frame was drawn: coarser at once where frames take too long.
   * @param {number} ms - it took
   * @param {boolean} all - everything was drawn, as at rest: where that is slow, the next movement begins coarser
   */
  frame(ms, all = false) {
    if (all && this.name !== "high" && this.step === 0 && ms > 2 * MAX_FRAME_MS)
      this.#go(Math.round(1 + Math.log2(ms / MAX_FRAME_MS)));
    else if (all && this.step > 0) return;
    else if (this.settling > 0) this.settling--;
    else if (this.name !== "high" && ms > MAX_FRAME_MS) {
      this.slow++;
      if (this.slow >= PATIENCE) this.#go(this.step + (ms > 3 * MAX_FRAME_MS ? 2 : 1));
    } else this.slow = 0;
  }

  /** Twice a second: coarser where drawing is slow, finer where there is room. */
  tick() {
    this.resting = Math.max(0, this.resting - 1);
    const fps = this.viewer.pace.sustained();
    if (fps === null || this.name === "high" || this.settling > 0) return;
    this.fast = fps > FAST_FPS ? this.fast + 1 : 0;
    if (fps < SLOW_FPS && this.slow === 0) this.#go(this.step + 1);
    else if (this.fast >= COURAGE && !this.resting) this.#go(this.step - 1);
  }

  /** @param {number} step */
  #go(step) {
    const next = Math.min(Math.max(step, 0), CHOICES[this.name].length - 1);
    if (next > this.step) this.resting = COOL_DOWN;
    this.slow = this.fast = 0;
    if (next === this.step) return;
    this.step = next;
    this.settling = 2;
    this.#apply();
  }

  get #now() {
    return CHOICES[this.name][this.step];
  }

  #apply() {
    const { viewer } = this,
      { resolution, share, warps = false } = this.#now;
    viewer.painter.warps = warps;
    viewer.resolution = resolution;
    viewer.share = share;
    viewer.resize();
    const asked = this.name === "low" && this.total > 1 ? this.total - 1 : null;
    if (asked === this.asked) return;
    this.asked = asked;
    viewer.tell({ type: "wishes", wishes: this.wishes() });
    viewer.levels = asked ?? Infinity;
    viewer.viewChanged();
  }

  /** In words. */
  explain() {
    const { resolution, share, warps } = this.#now,
      levels = this.total ? ` ${this.asked ?? this.total} of ${this.total} levels.` : "";
    if (resolution === 1) return `Drawn in full.${levels}`;
    if (warps) return `While it moves: the last picture, moved along. At rest everything.${levels}`;
    const splats = share < 1 ? ` and ${Math.round(100 * share)} % of the splats` : "";
    return `While it moves: ${Math.round(100 * resolution)} % of the resolution${splats}. At rest everything.${levels}`;
  }
}
