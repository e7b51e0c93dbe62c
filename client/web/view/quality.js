/** Auto, high or low: how fine the picture is drawn, and how many levels are asked for. */

/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {"auto" | "high" | "low"} Name */

/** @type {{ name: Name, label: string, note: string }[]} */
export const QUALITIES = [
  { name: "auto", label: "Auto", note: "keeps it smooth" },
  { name: "high", label: "High", note: "all levels" },
  { name: "low", label: "Low", note: "saves data" },
];
const SLOW_FPS = 12, FAST_FPS = 30;
const PATIENCE = 2, COURAGE = 16; // measurements in a row before a step down or up
const COOL_DOWN = 60; // heartbeats before a step that proved too slow is tried again
const LINGER = 8; // heartbeats before a level that no view calls for is given up

/**
 * What auto gives up, little by little: fraction of the screen's resolution while things move, and how far away fine
 * levels are drawn (1: the selection by distance of codec/FORMAT.md section 14; 2: from twice as far).
 */
const STEPS = [
  { resolution: 1, reach: Infinity }, { resolution: 0.75, reach: Infinity }, { resolution: 0.5, reach: Infinity },
  { resolution: 0.5, reach: 2 }, { resolution: 0.35, reach: 1 }, { resolution: 0.35, reach: 0.5 },
];
/** @type {Record<Name, typeof STEPS>} */
const CHOICES = { auto: STEPS, high: STEPS.slice(0, 1), low: STEPS.slice(1, 2) };

export class Quality {
  /** @param {Viewer} viewer @param {string | null} wanted */
  constructor(viewer, wanted) {
    this.viewer = viewer;
    this.total = 0; // levels of the stream
    this.step = 0;
    this.slow = 0;
    this.fast = 0;
    this.settling = false; // the next measurement still holds frames from before a step
    this.resting = 0; // heartbeats until a finer step may be tried
    this.called = Infinity; // levels that the view calls for
    this.idle = 0; // heartbeats for which it called for fewer than are asked for
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

  /** How many levels the view that is shown calls for. @param {number} levels */
  need(levels) {
    this.called = levels;
    if (this.asked !== null && levels > this.asked) this.#apply();
  }

  /** Twice a second: draw coarser where drawing is slow, finer where there is room. */
  tick() {
    this.resting = Math.max(0, this.resting - 1);
    this.idle = this.#wanted < (this.asked ?? this.total) ? this.idle + 1 : 0;
    if (this.idle > LINGER) this.#apply();
    const fps = this.viewer.pace();
    if (fps === null || this.name !== "auto") return;
    if (this.settling) {
      this.settling = false;
      return;
    }
    this.slow = fps < SLOW_FPS ? this.slow + (fps < SLOW_FPS / 2 ? PATIENCE : 1) : 0;
    this.fast = fps > FAST_FPS ? this.fast + 1 : 0;
    const down = this.slow >= PATIENCE ? (fps < SLOW_FPS / 3 ? 2 : 1) : 0;
    const up = this.fast >= COURAGE && !this.resting ? 1 : 0;
    const step = Math.min(Math.max(this.step + down - up, 0), STEPS.length - 1);
    if (step === this.step) return;
    if (down) this.resting = COOL_DOWN;
    this.step = step;
    this.slow = this.fast = 0;
    this.settling = true;
    this.#apply();
  }

  get #now() {
    return CHOICES[this.name][this.step];
  }

  /** How many levels are wanted. */
  get #wanted() {
    if (this.name === "low") return Math.max(1, this.total - 1);
    return this.#now.reach === Infinity ? this.total : Math.min(this.called, this.total);
  }

  #apply() {
    const { viewer } = this, { resolution, reach } = this.#now;
    viewer.resolution = resolution;
    viewer.resize();
    const asked = this.total && this.#wanted < this.total ? this.#wanted : null;
    this.idle = 0;
    if (viewer.reach !== reach) {
      viewer.reach = reach;
      viewer.viewChanged();
    }
    if (asked === this.asked) return;
    this.asked = asked;
    viewer.tell({ type: "wishes", wishes: this.wishes() });
    viewer.levels = asked ?? Infinity;
    viewer.viewChanged();
  }

  /** In words. */
  explain() {
    const share = Math.round(100 * this.viewer.resolution), shown = Math.min(this.asked ?? this.total, this.total);
    const levels = this.total ? `, ${shown} of ${this.total} levels` : "";
    return `Drawn at ${share} % of the screen's resolution${share < 100 ? " while it moves" : ""}${levels}.`;
  }
}
