/** The bar at the bottom: what is retained, pause, scrub, step, loop, speed and the way back to the live edge. */

import { button, element, setIcon } from "./page.js";
import { clock } from "./states.js";
import { Marks } from "./marks.js";
import { Bar, Times } from "./times.js";

/** @typedef {import("../stream/session.js").Status} Status */
/** @typedef {import("../stream/session.js").Position} Position */
/** @typedef {import("./times.js").Span} Span */

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const SCRUB_MS = 90; // between two seeks while dragging
const ARROW_SECONDS = 5,
  PAGE_SECONDS = 30; // by keys on the bar
const BEFORE_BEGIN_SECONDS = -1e9;
export const MOVING = ["live", "behind", "replay"]; // phases in which pictures go on by themselves
const OVER = ["ended", "deleted"]; // phases of streams that will not go on

/** @type {Record<string, number>} */
const BAR_KEYS = {
  ArrowLeft: -ARROW_SECONDS,
  ArrowDown: -ARROW_SECONDS,
  ArrowRight: ARROW_SECONDS,
  ArrowUp: ARROW_SECONDS,
  PageDown: -PAGE_SECONDS,
  PageUp: PAGE_SECONDS,
  Home: BEFORE_BEGIN_SECONDS,
  End: Infinity,
};

export class Timeline {
  /** @param {(messages: object[]) => void} send @param {string | null} marks - frame numbers, from the address */
  constructor(send, marks) {
    this.send = send;
    this.recording = false; // a file: has speed, has no newest frame that moves
    this.times = new Times();
    /** @type {Span[]} as the server told last, in order */
    this.spans = [];
    this.strip = new Bar([], this.times, null);
    this.bar = element("timeline");
    this.scrub = /** @type {HTMLInputElement} */ (element("t-scrub"));
    /** @type {Status | null} */
    this.status = null;
    this.loop = false;
    this.speed = 1;
    this.pausing = false; // it was asked for, and not answered yet
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
      this.seekTo(this.strip.positionAt(Number(this.scrub.value)));
    };
    this.scrub.onkeydown = (event) => {
      const by = BAR_KEYS[event.key];
      if (by === undefined) return;
      event.preventDefault();
      if (by === Infinity && !this.recording) this.live();
      else this.skip(by);
    };
    this.marks = new Marks(this);
    for (const mark of marks?.split(",") ?? [])
      if (/^\d+$/.test(mark)) this.marks.toggle({ epoch: null, version: Number(mark) });
  }

  /** Something else is watched from now on. */
  forget() {
    this.times = new Times();
    this.spans = [];
    this.strip = new Bar([], this.times, null);
    this.recording = this.pausing = false;
    this.status = null;
  }

  /** From now on a file is played. @param {boolean} loop */
  playFile(loop) {
    this.recording = true;
    button("t-live").hidden = true;
    this.loop = loop;
    button("t-loop").setAttribute("aria-pressed", String(loop));
  }

  /** A file was read: all that it holds. @param {{ version: number, timeMs: number }[]} moments */
  holds(moments) {
    for (const { version, timeMs } of moments) this.times.note({ epoch: 1, version }, timeMs);
    this.#layOut();
  }

  /** A picture was shown. @param {Position} position @param {number} ms - when it was filmed */
  filmed(position, ms) {
    this.times.note(position, ms);
  }

  /** When a position was filmed, ms. @param {Position} position */
  filmedAt(position) {
    return this.times.at(position, this.status?.fps ?? null);
  }

  /** The server told what it retains. @param {import("./past.js").Group[]} groups */
  retained(groups) {
    /** @type {Map<number, Span>} */
    const spans = new Map();
    for (const { epoch, first, last, begun_ns: begun, first_time_ns: from, last_time_ns: to } of groups) {
      const span = spans.get(epoch) ?? { epoch, first, last };
      spans.set(epoch, { epoch, first: Math.min(span.first, first), last: Math.max(span.last, last) });
      const begin = from ?? (this.status?.source === "cameras" ? begun : null);
      if (begin != null) this.times.note({ epoch, version: first }, begin / 1e6);
      if (to != null) this.times.note({ epoch, version: last }, to / 1e6);
    }
    this.spans = [...spans.values()].sort((a, b) => a.epoch - b.epoch);
    if (this.status) this.update(this.status);
  }

  /** The bar of what can be sought now. */
  #layOut() {
    const { window: range, status } = this;
    if (!range) return;
    const { oldest, newest } = range,
      { epoch } = newest;
    const before = this.spans.filter((span) => span.epoch >= oldest.epoch && span.epoch < epoch);
    const inNewest =
      oldest.epoch === epoch
        ? oldest.version
        : Math.min(this.spans.find((span) => span.epoch === epoch)?.first ?? 0, newest.version);
    const cut = before.map((span) =>
      span.epoch === oldest.epoch
        ? { ...span, first: Math.min(Math.max(span.first, oldest.version), span.last) }
        : span,
    );
    this.strip = new Bar(
      [...cut, { epoch, first: inNewest, last: Math.max(newest.version, this.#shown(epoch)) }],
      this.times,
      status?.fps ?? null,
    );
    this.#drawGaps();
  }

  /** @param {number} epoch */
  #shown(epoch) {
    const { position } = this.status ?? {};
    return position?.epoch === epoch ? position.version : 0;
  }

  #drawGaps() {
    const { parts, seconds } = this.strip,
      share = (/** @type {number} */ at) => `${((100 * at) / (seconds || 1)).toFixed(2)}%`;
    const stripes = parts.slice(1).map((part, i) => {
      const end = parts[i].begin + parts[i].seconds;
      return `transparent ${share(end)}, var(--stage) ${share(end)} ${share(part.begin)}, transparent ${share(part.begin)}`;
    });
    this.scrub.style.setProperty(
      "--gaps",
      stripes.length ? `linear-gradient(to right, ${stripes.join(", ")})` : "none",
    );
  }

  get window() {
    return this.status?.window ?? null;
  }

  /** What is shown, or the newest. @returns {Position | null} */
  get position() {
    return this.status?.position ?? this.window?.newest ?? null;
  }

  get version() {
    return this.position?.version ?? 0;
  }

  get paused() {
    return this.pausing || this.status?.mode === "paused" || this.status?.stopping === true;
  }

  /** Whether nothing moves until somebody says so. */
  get stands() {
    return this.paused || this.status?.phase === "ended" || this.status?.phase === "deleted";
  }

  /** A version of the newest epoch, inside of what can be sought. @param {number} version */
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

  /** Show a version of the newest epoch. @param {number} version */
  seek(version) {
    this.seekTo(this.at(version));
  }

  /** Show a position; playing goes on from there, unless paused. @param {Position | null} to */
  seekTo(to) {
    if (to) this.send([{ type: "seek", to, stop: this.paused }]);
  }

  /** Go back or on in time. @param {number} seconds */
  skip(seconds) {
    const { position, strip } = this;
    if (!position) return;
    const place = strip.placeAfter(strip.filmedBefore(strip.placeOf(position)) + seconds);
    if (place >= strip.seconds && !this.recording) return this.live();
    this.seekTo(strip.after(position, seconds));
  }

  /** Stand still at a moment; `epoch` null: of the newest one. @param {number} version @param {number | null} epoch */
  showMoment(version, epoch) {
    const to = epoch === null ? this.at(version) : { epoch, version };
    if (to) this.send([...(this.recording ? [{ type: "pause" }] : []), { type: "seek", to, stop: true }]);
  }

  live() {
    this.pausing = false;
    this.send([{ type: "seek", to: "live" }]);
  }

  /** The begin of what is retained. */
  begin() {
    this.seekTo(this.strip.positionAt(0) ?? this.at(0));
  }

  toggle() {
    if (this.paused) this.play();
    else if (this.status?.phase !== "ended") this.pause();
    else if (this.recording) this.play();
    else this.begin();
  }

  /** Go on from here. */
  play() {
    this.pausing = false;
    this.send([{ type: "play" }]);
  }

  pause() {
    this.pausing = true;
    this.send([{ type: "pause" }]);
  }

  /** @param {number} by - frames */
  step(by) {
    const { position, window } = this;
    if (position && window && position.epoch < window.newest.epoch)
      this.showMoment(Math.max(0, position.version + by), position.epoch);
    else this.showMoment(this.version + by, null);
  }

  /** @param {boolean} on */
  setLoop(on) {
    this.loop = on;
    button("t-loop").setAttribute("aria-pressed", String(on));
    if (this.recording) this.send([{ type: "loop", value: on }]);
    else if (on && this.status?.mode === "live") this.begin();
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.speed = speed;
    button("t-speed").textContent = `${speed}×`;
    this.send([{ type: "speed", value: speed }]);
  }

  #drag() {
    this.dragging = true;
    const place = Number(this.scrub.value);
    this.#show(place);
    const now = performance.now();
    if (now - this.lastSeek < SCRUB_MS) return;
    this.lastSeek = now;
    this.seekTo(this.strip.positionAt(place));
  }

  /** @param {Status} status */
  update(status) {
    const before = this.status;
    this.status = status;
    if (status.mode === "paused") this.pausing = false;
    button("t-speed").hidden = !this.recording && status.mode !== "replay";
    this.bar.hidden = !status.window;
    if (!status.window) return;
    if (status.newestMs !== null) this.times.note(status.window.newest, status.newestMs);
    if (status.position && status.filmedMs !== null) this.times.note(status.position, status.filmedMs);
    this.#layOut();
    const atEdge = status.mode === "live" && !this.recording;
    if (this.loop && !this.recording && before?.mode === "replay" && atEdge) this.begin();
    setIcon("t-play", this.stands ? "play" : "pause");
    button("t-play").setAttribute("aria-label", this.stands ? "Play" : "Pause");
    button("t-play").title = this.stands ? "Play (Space)" : "Pause (Space)";
    element("t-live-text").textContent =
      status.source !== "cameras" ? "NEWEST" : OVER.includes(status.phase) ? "END" : "LIVE";
    const { position, strip } = this;
    if (!this.dragging) this.#show(atEdge || !position ? strip.seconds : strip.placeOf(position));
  }

  /** @param {number} place - on the bar, seconds from its left */
  #show(place) {
    const { strip, status } = this,
      length = strip.seconds;
    Object.assign(this.scrub, { min: "0", max: String(length) });
    if (!this.dragging) this.scrub.value = String(place);
    this.scrub.style.setProperty("--done", `${(length > 0 ? (100 * place) / length : 100).toFixed(2)}%`);
    this.marks.place();
    const behind = strip.behind(place, status?.source === "cameras"),
      live = status?.mode === "live" && !this.dragging;
    const filmed = clock(strip.filmedBefore(place)),
      all = clock(strip.filmedBefore(length));
    const text = this.recording ? `${filmed} / ${all}` : live || behind <= 0 ? filmed : `−${clock(behind)}`;
    element("t-time").textContent = text;
    this.scrub.setAttribute(
      "aria-valuetext",
      this.recording || live ? text : `${clock(behind)} behind live, frame ${strip.positionAt(place)?.version ?? 0}`,
    );
  }
}
