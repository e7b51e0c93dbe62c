/** Auto, high or low: how many levels are asked for and how fine the picture is drawn. */

/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {"auto" | "high" | "low"} Name */

/** @type {{ name: Name, label: string, note: string }[]} */
export const QUALITIES = [
  { name: "auto", label: "Auto", note: "keeps it smooth" },
  { name: "high", label: "High", note: "all levels" },
  { name: "low", label: "Low", note: "saves data" },
];
const SLOW_FPS = 20, FAST_FPS = 45, PATIENCE = 4; // heartbeats in a row before a change
const RESOLUTIONS = [1, 0.75, 0.5];

export class Quality {
  /** @param {Viewer} viewer @param {string | null} wanted */
  constructor(viewer, wanted) {
    this.viewer = viewer;
    this.total = 0; // levels of the stream
    this.step = 0; // of RESOLUTIONS, in auto
    this.slow = 0;
    this.fast = 0;
    this.frames = 0;
    /** @type {Name} */
    this.name = wanted === "high" || wanted === "low" ? wanted : "auto";
    this.#apply();
  }

  /** @param {Name} name */
  choose(name) {
    this.name = name;
    this.step = 0;
    this.#apply();
    this.viewer.tell({ type: "wishes", wishes: this.wishes() });
  }

  /** How many levels the stream has. @param {number | null} levels */
  limit(levels) {
    if (!levels || levels === this.total) return;
    this.total = levels;
    this.#apply();
    if (this.name === "low") this.viewer.tell({ type: "wishes", wishes: this.wishes() });
  }

  get #levels() {
    return this.name === "low" && this.total ? Math.max(1, this.total - 1) : 16;
  }

  /** What to ask the server for. */
  wishes() {
    return { levels: this.name === "low" && this.total ? this.#levels : null };
  }

  /** Twice a second: draw coarser where drawing is slow, finer where there is room. */
  tick() {
    const { viewer } = this;
    const drawn = viewer.frames - this.frames;
    this.frames = viewer.frames;
    if (this.name !== "auto" || drawn < 3) return;
    this.slow = viewer.fps < SLOW_FPS ? this.slow + 1 : 0;
    this.fast = viewer.fps > FAST_FPS ? this.fast + 1 : 0;
    const change = this.slow >= PATIENCE ? 1 : this.fast >= 4 * PATIENCE ? -1 : 0;
    const step = Math.min(Math.max(this.step + change, 0), RESOLUTIONS.length - 1);
    if (step === this.step) return;
    this.step = step;
    this.slow = this.fast = 0;
    this.#apply();
  }

  #apply() {
    const { viewer } = this;
    viewer.resolution = this.name === "low" ? 0.75 : this.name === "high" ? 1 : RESOLUTIONS[this.step];
    viewer.resize();
    if (viewer.levels === this.#levels) return;
    viewer.levels = this.#levels;
    viewer.viewChanged();
  }

  /** In words. */
  explain() {
    const share = Math.round(100 * this.viewer.resolution);
    const levels = this.total ? `, ${Math.min(this.#levels, this.total)} of ${this.total} levels` : "";
    return `Drawn at ${share} % of the screen's resolution${levels}.`;
  }
}
