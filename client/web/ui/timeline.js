/** The bar at the bottom: the retained window, pause, scrub, step, loop, speed and the way back to the live edge. */

import { button, element, setIcon } from "./page.js";
import { clock } from "./states.js";

/** @typedef {import("../stream/session.js").Status} Status */
/** @typedef {import("../stream/session.js").Position} Position */

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const SCRUB_MS = 90; // between two seeks while dragging

export class Timeline {
  /** @param {(messages: object[]) => void} send @param {string | null} marks - frame numbers, from the address */
  constructor(send, marks) {
    this.send = send;
    /** @type {Map<number, HTMLElement>} moments to come back to */
    this.marks = new Map();
    this.recording = false; // a file: has speed, has no newest frame that moves
    this.bar = element("timeline");
    this.scrub = /** @type {HTMLInputElement} */ (element("t-scrub"));
    /** @type {Status | null} */
    this.status = null;
    this.loop = false;
    this.speed = 1;
    this.dragging = false;
    this.lastSeek = 0;
    button("t-play").onclick = () => this.toggle();
    button("t-back").onclick = () => this.step(-1);
    button("t-forward").onclick = () => this.step(1);
    button("t-live").onclick = () => this.live();
    button("t-loop").onclick = () => this.setLoop(!this.loop);
    button("t-speed").onclick = () => this.setSpeed(SPEEDS[(SPEEDS.indexOf(this.speed) + 1) % SPEEDS.length]);
    this.scrub.oninput = () => this.#drag();
    this.scrub.onchange = () => {
      this.dragging = false;
      this.seek(Number(this.scrub.value));
    };
    for (const mark of marks?.split(",") ?? []) this.mark(Number(mark));
  }

  /** Mark a moment on the bar, or take its mark away. @param {number} version */
  mark(version) {
    const old = this.marks.get(version);
    old?.remove();
    if (this.marks.delete(version)) return;
    const mark = Object.assign(document.createElement("button"), { onclick: () => this.seek(version) });
    element("t-marks").append(mark);
    this.marks.set(version, mark);
    this.#placeMarks();
  }

  /** The version that was marked last. */
  get newestMark() {
    return [...this.marks.keys()].pop();
  }

  #placeMarks() {
    const { window, oldest } = this;
    for (const [version, mark] of this.marks) {
      mark.hidden = !window || !(version >= oldest && version <= window.newest.version);
      mark.title = `Mark at ${clock(version - oldest, this.status?.fps ?? null)}`;
      mark.style.setProperty("--at", String(this.#share(version)));
    }
  }

  /** Where a version lies on the bar, 0 to 1. @param {number} version */
  #share(version) {
    const { oldest } = this, newest = Math.max(this.window?.newest.version ?? 0, this.version);
    return newest > oldest ? (version - oldest) / (newest - oldest) : 1;
  }

  /** From now on a file is played. @param {boolean} loop */
  playFile(loop) {
    this.recording = true;
    button("t-live").hidden = true;
    button("t-speed").hidden = false;
    this.loop = loop;
    button("t-loop").setAttribute("aria-pressed", String(loop));
  }

  get window() {
    return this.status?.window ?? null;
  }

  get version() {
    return this.status?.position?.version ?? this.window?.newest.version ?? 0;
  }

  get paused() {
    return this.status?.mode === "paused";
  }

  /** Whether nothing moves until somebody says so. */
  get stands() {
    return this.paused || this.status?.phase === "ended" || this.status?.phase === "deleted";
  }

  /** @param {number} version */
  at(version) {
    const window = this.window;
    if (!window) return null;
    const inside = Math.min(Math.max(version, this.oldest), window.newest.version);
    return { epoch: window.newest.epoch, version: inside };
  }

  /** Oldest version of the newest epoch. */
  get oldest() {
    const window = this.window;
    return !window ? 0 : window.oldest.epoch === window.newest.epoch ? window.oldest.version : 0;
  }

  /** Show `version`; playing goes on from there, unless paused. @param {number} version */
  seek(version) {
    const to = this.at(version);
    if (to) this.send([{ type: "seek", to, stop: this.paused }]);
  }

  /** Stand still at a moment; `epoch` null: of the newest one. @param {number} version @param {number | null} epoch */
  showMoment(version, epoch) {
    const to = epoch === null ? this.at(version) : { epoch, version };
    if (to) this.send([...(this.recording ? [{ type: "pause" }] : []), { type: "seek", to, stop: true }]);
  }

  live() {
    this.send([{ type: "seek", to: "live" }]);
  }

  toggle() {
    if (this.paused) this.send([{ type: "play" }]);
    else if (this.status?.phase !== "ended") this.pause();
    else if (this.recording) this.send([{ type: "play" }]);
    else this.seek(this.oldest);
  }

  pause() {
    this.send([{ type: "pause" }]);
  }

  /** @param {number} by - frames */
  step(by) {
    this.showMoment(this.version + by, null);
  }

  /** @param {boolean} on */
  setLoop(on) {
    this.loop = on;
    button("t-loop").setAttribute("aria-pressed", String(on));
    if (this.recording) this.send([{ type: "loop", value: on }]);
    else if (on && this.status?.mode === "live") this.seek(this.oldest);
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.speed = speed;
    button("t-speed").textContent = `${speed}×`;
    this.send([{ type: "speed", value: speed }]);
  }

  #drag() {
    this.dragging = true;
    this.#show(Number(this.scrub.value));
    const now = performance.now();
    if (now - this.lastSeek < SCRUB_MS) return;
    this.lastSeek = now;
    this.seek(Number(this.scrub.value));
  }

  /** @param {Status} status */
  update(status) {
    const before = this.status;
    this.status = status;
    this.bar.hidden = !status.window;
    if (!status.window) return;
    const atEdge = status.mode === "live" && !this.recording;
    if (this.loop && !this.recording && before?.mode === "replay" && atEdge) this.seek(this.oldest);
    setIcon("t-play", this.stands ? "play" : "pause");
    button("t-play").setAttribute("aria-label", this.stands ? "Play" : "Pause");
    button("t-play").title = this.stands ? "Play (Space)" : "Pause (Space)";
    element("t-live-text").textContent = status.source === "cameras" ? "LIVE" : "NEWEST";
    if (!this.dragging) this.#show(atEdge ? Math.max(this.version, status.window.newest.version) : this.version);
  }

  /** @param {number} version */
  #show(version) {
    const window = this.window;
    if (!window) return;
    const { oldest } = this, newest = Math.max(window.newest.version, this.version);
    Object.assign(this.scrub, { min: String(oldest), max: String(newest) });
    if (!this.dragging) this.scrub.value = String(version);
    this.scrub.style.setProperty("--done", `${(100 * this.#share(version)).toFixed(2)}%`);
    this.#placeMarks();
    const fps = this.status?.fps ?? null, behind = newest - version;
    const live = this.status?.mode === "live" && !this.dragging;
    const text = this.recording ? `${clock(version - oldest, fps)} / ${clock(newest - oldest, fps)}` : live || behind <= 0 ? clock(version - oldest, fps) : `−${clock(behind, fps)}`;
    element("t-time").textContent = text;
    this.scrub.setAttribute("aria-valuetext", this.recording || live ? text : `${clock(behind, fps)} behind live, frame ${version}`);
  }
}
