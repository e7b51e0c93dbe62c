/** Auto, high or low: how many levels are asked for and how fine the picture is drawn. */

/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {"auto" | "high" | "low"} Name */

/** @type {{ name: Name, label: string, note: string }[]} */
export const QUALITIES = [
  { name: "auto", label: "Auto", note: "keeps it smooth" },
  { name: "high", label: "High", note: "all levels" },
  { name: "low", label: "Low", note: "saves data" },
];
const MOST_LEVELS = 16;
const SLOW_FPS = 20, FAST_FPS = 45, PATIENCE = 4; // heartbeats in a row before a change
const COOL_DOWN = 120; // heartbeats before a step that proved too slow is tried again

/** What auto gives up, little by little: fraction of the screen's resolution, finest levels left out. */
const STEPS = [[1, 0], [0.75, 0], [0.5, 0], [0.5, 1], [0.5, 2]];

export class Quality {
  /** @param {Viewer} viewer @param {string | null} wanted */
  constructor(viewer, wanted) {
    this.viewer = viewer;
    this.total = 0; // levels of the stream
    this.step = 0; // of STEPS, in auto
    this.slow = 0;
    this.fast = 0;
    this.frames = 0;
    this.resting = 0; // heartbeats until a finer step may be tried
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
    const without = this.name === "low" ? 1 : this.name === "auto" ? STEPS[this.step][1] : 0;
    return this.total && without ? Math.max(1, this.total - without) : MOST_LEVELS;
  }

  /** What to ask the server for. */
  wishes() {
    return { levels: this.#levels === MOST_LEVELS ? null : this.#levels };
  }

  /** Twice a second: draw coarser where drawing is slow, finer where there is room. */
  tick() {
    const { viewer } = this;
    const drawn = viewer.frames - this.frames;
    this.frames = viewer.frames;
    if (this.name !== "auto" || drawn < 3) return;
    this.slow = viewer.fps < SLOW_FPS ? this.slow + 1 : 0;
    this.fast = viewer.fps > FAST_FPS ? this.fast + 1 : 0;
    this.resting = Math.max(0, this.resting - 1);
    const change = this.slow >= PATIENCE ? 1 : this.fast >= 4 * PATIENCE && !this.resting ? -1 : 0;
    const step = Math.min(Math.max(this.step + change, 0), STEPS.length - 1);
    if (step === this.step) return;
    const levels = this.#levels;
    this.step = step;
    this.slow = this.fast = 0;
    if (change > 0) this.resting = COOL_DOWN;
    this.#apply();
    if (this.#levels !== levels) viewer.tell({ type: "wishes", wishes: this.wishes() });
  }

  #apply() {
    const { viewer } = this;
    viewer.resolution = this.name === "low" ? 0.75 : this.name === "high" ? 1 : STEPS[this.step][0];
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
