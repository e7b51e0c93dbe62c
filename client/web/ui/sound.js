/**
 * The sound of what is shown: an audio element that is kept in step with the pictures; docs/sound.md.
 *
 * Nothing is loaded before somebody asks for sound. Pictures are the clock: each tells what was filmed when it is on
 * the screen; the element runs a little faster or slower to be there too, and jumps where that would take long.
 */

import { LiveSound } from "../view/live-sound.js";
import { PlacedSound, microphoneAt } from "../view/placed-sound.js";
import { element } from "./page.js";
import { MOVING } from "./timeline.js";

const STEP_MS = 100; // from one correction to the next
const JUMP_MS = 150; // further off, it jumps
const JUMP_PAUSE_MS = 700; // that a jump may take
const PULL_MS = 500; // in which what it is off is made up for
const MAX_PULL = 0.15; // by which it runs faster or slower, at its pitch
const SMOOTH = 0.15; // share of a new picture in the clock: pictures come unevenly
const SEEK_MS = 300; // the clock is this far off what a picture says: it was sought
const LATE_MS = 400,
  LATE_PICTURES = 2; // that pictures stay away before sound waits for them
const SPARSE_MS = 1000; // so far apart, pictures are reached before the next one is due: sound does not wait for that
const MAX_TRIES = 2; // to load it, after the first
const HEAD_BYTES = 4096; // both headers of the file
const LINK_SECONDS = 24 * 3600;
const NEAR_END = 0.05; // s, of what is held: an element that gets there stops

/**
 * What is known of sound before it is loaded: `beginMs` of its first sample, on the clock of the pictures, and the
 * camera at which its microphone stands.
 * @typedef {{ beginMs: number, camera?: string | null }} Told
 */

export class Sound {
  /**
   * @param {import("../view/viewer.js").Viewer} viewer
   * @param {import("./timeline.js").Timeline} timeline
   * @param {string | null} address - of an Ogg Opus file; null for live sound, which comes with the pictures
   * @param {string | null} token - where the server of streams wants one
   * @param {Told | null} told - null: as the file says
   */
  constructor(viewer, timeline, address, token, told) {
    this.viewer = viewer;
    this.timeline = timeline;
    this.address = address;
    this.token = token;
    this.told = told;
    /** @type {PlacedSound | null} */
    this.placed = null;
    this.ends = new AbortController();
    const { signal } = this.ends;
    this.live = address === null ? new LiveSound(viewer, signal) : null;
    this.audio = new Audio();
    this.audio.preload = "auto";
    this.audio.crossOrigin = "anonymous"; // else what other sites send could not be placed
    this.isOn = false;
    this.clock = NaN; // what was filmed, less the time of this page times the speed, ms
    this.speed = 1;
    this.shown = { filmed: NaN, at: 0, gap: 0 }; // newest picture, ms
    this.beganAt = NaN; // by the clock of the worker, ms
    this.jumpedAt = -Infinity;
    this.tried = 0; // loading
    this.opener = Object.assign(document.createElement("button"), {
      id: "t-sound",
      innerHTML: '<svg viewBox="0 0 24 24"><path/></svg>',
    });
    this.opener.onclick = () => this.#turn(!this.isOn);
    this.volume = Object.assign(document.createElement("input"), {
      id: "t-volume",
      type: "range",
      min: "0",
      max: "1",
      step: "any",
      value: "1",
      ariaLabel: "Volume",
    });
    this.volume.style.width = "64px";
    this.volume.oninput = () => (this.audio.volume = Number(this.volume.value));
    element("t-time").after(this.opener, this.volume);
    viewer.addEventListener("picture", (event) => this.#note(/** @type {CustomEvent} */ (event).detail), { signal });
    viewer.addEventListener("status", (event) => this.#begin(/** @type {CustomEvent} */ (event).detail), { signal });
    viewer.addEventListener("scene", () => this.#place(), { signal });
    this.audio.addEventListener("error", () => this.isOn && this.#load(), { signal }); // perhaps the address has expired
    this.timer = setInterval(() => this.#step(performance.now()), STEP_MS);
    this.#turn(false);
  }

  /** What programs are told; `behindMs` is how far it is behind the picture. */
  get state() {
    const { audio } = this,
      now = performance.now();
    const beginMs = this.told?.beginMs ?? null,
      heard = 1000 * audio.currentTime - this.speed * this.#lateMs + (beginMs ?? 0);
    return {
      on: this.isOn,
      beginMs,
      placed: this.placed !== null,
      playing: !audio.paused && !audio.seeking,
      volume: audio.volume,
      timeMs: heard,
      behindMs: this.#filmed(now) - heard,
    };
  }

  /** Time that is shown now. @param {number} now */
  #filmed(now) {
    return this.clock + this.speed * now;
  }

  /** @param {import("../view/messages.js").PictureMessage} picture */
  #note({ timeMs, overMs }) {
    const now = performance.now(),
      filmed = timeMs ?? NaN;
    if (Number.isNaN(filmed) || filmed === this.shown.filmed) return; // the same from elsewhere
    const { speed } = this.timeline;
    this.shown = { filmed, at: now, gap: Math.max(0, filmed - this.shown.filmed) / speed || 0 };
    const over = overMs && overMs < SPARSE_MS ? overMs : 0;
    const clock = filmed - speed * (now + over); // it is reached then
    const isOld = speed !== this.speed || !(Math.abs(clock - this.clock) < SEEK_MS);
    this.speed = speed;
    this.clock = isOld ? clock : this.clock + SMOOTH * (clock - this.clock);
  }

  /** How long the picture that is shown stays, ms, as far as that is known. */
  get #gap() {
    const { position, status, speed } = this.timeline;
    if (!position || status?.mode === "live") return this.shown.gap;
    const next = { ...position, version: position.version + 1 };
    return Math.max(this.shown.gap, (this.timeline.filmedAt(next) - this.timeline.filmedAt(position)) / speed);
  }

  /**
   * It plays on, perhaps the picture that was there: from when and where is known.
   * @param {{ status: import("../stream/session.js").Status, now: number }} told
   */
  #begin({ status: { began }, now }) {
    if (!began || began.at === this.beganAt) return;
    this.beganAt = began.at;
    this.speed = this.timeline.speed;
    this.shown.at = performance.now() - (now - began.at);
    this.clock = began.filmedMs - this.speed * this.shown.at;
  }

  /** @param {number} now */
  #step(now) {
    const { audio, viewer, shown } = this;
    if (!this.isOn) return;
    const isLate = now - shown.at > LATE_MS + LATE_PICTURES * this.#gap;
    const at = this.#filmed(now + this.#lateMs) - (this.told?.beginMs ?? NaN),
      off = 1000 * audio.currentTime - at;
    const isOutside = this.live
      ? !isHeld(audio.buffered, at / 1000)
      : !(at >= 0) || at > 1000 * (audio.duration || Infinity);
    if (isLate || isOutside || this.timeline.stands || !MOVING.includes(viewer.status?.phase ?? "")) {
      audio.pause();
      if (isLate) this.clock = NaN;
      return;
    }
    if (Math.abs(off) > JUMP_MS && now - this.jumpedAt > JUMP_PAUSE_MS) {
      audio.currentTime = at / 1000;
      this.jumpedAt = now;
    }
    const pull = Math.min(Math.max(off / PULL_MS, -MAX_PULL), MAX_PULL);
    audio.playbackRate = this.speed * (1 - pull);
    this.placed?.wake();
    if (audio.paused) audio.play().catch(({ name }) => name === "AbortError" || this.#turn(false)); // not allowed yet; or paused before it began
  }

  /** How long what the element plays is under way to the ear. */
  get #lateMs() {
    return this.placed?.lateMs ?? 0;
  }

  /** Let it come from where its microphone stands, once it is wanted and both are known. */
  #place() {
    const { viewer } = this,
      at = microphoneAt(viewer.scene?.cameras ?? [], this.told?.camera);
    if (!this.isOn || !at) return;
    this.placed ??= new PlacedSound(viewer, this.audio, this.ends.signal);
    this.placed.stand(at);
  }

  async #load() {
    if (this.tried++ > MAX_TRIES) return this.#turn(false);
    let query = "";
    try {
      if (this.live || this.address === null) return this.live?.open(this.audio);
      this.told ??= await toldBy(this.address);
      this.#place();
      if (this.token) query = `?${await sign(this.address, this.token)}`;
      this.audio.src = this.address + query;
    } catch {
      this.#turn(false);
    }
  }

  /** Sound on or off. @param {boolean} on */
  #turn(on) {
    this.isOn = on;
    if (!on) {
      this.audio.pause();
      this.placed?.rest();
    } else if (!this.audio.src) this.#load();
    this.live?.turn(on);
    this.#place(); // now, as browsers want a gesture
    const name = on ? "Mute" : "Sound";
    Object.assign(this.opener, { title: name, ariaLabel: name, ariaPressed: String(on) });
    this.opener
      .querySelector("path")
      ?.setAttribute(
        "d",
        `M4 9.5v5h3.5L12 19V5L7.5 9.5z${on ? "M15 9a4 4 0 0 1 0 6M17.5 6.5a8 8 0 0 1 0 11" : "M15.5 9.5l5 5M20.5 9.5l-5 5"}`,
      );
    this.volume.hidden = !on;
  }

  /** Something else is shown from now on. */
  close() {
    clearInterval(this.timer);
    this.ends.abort();
    this.#turn(false);
    this.audio.removeAttribute("src");
    this.opener.remove();
    this.volume.remove();
  }
}

/** Whether there is sound at a time. @param {TimeRanges} ranges @param {number} at - s */
function isHeld(ranges, at) {
  for (let i = 0; i < ranges.length; i++) if (ranges.start(i) <= at && at < ranges.end(i) - NEAR_END) return true;
  return false;
}

/** What a file says of itself, in comments in its first bytes. @param {string} address @returns {Promise<Told>} */
async function toldBy(address) {
  const answer = await fetch(address, { headers: { Range: `bytes=0-${HEAD_BYTES - 1}` } });
  const head = new TextDecoder("latin1").decode(
    answer.ok ? (await answer.arrayBuffer()).slice(0, HEAD_BYTES) : undefined,
  );
  return { beginMs: Number(/STREAMLOD_BEGIN_NS=(\d{1,19})/i.exec(head)?.[1] ?? 0) / 1e6, camera: cameraIn(head) };
}

/** The camera that a file names: a JSON string. @param {string} head */
function cameraIn(head) {
  try {
    return JSON.parse(/STREAMLOD_CAMERA=("(?:[^"\\]|\\.)*")/i.exec(head)?.[1] ?? "null");
  } catch {
    return null;
  }
}

/**
 * What to add to the address of a stream's sound: an audio element cannot send a token.
 * @param {string} address
 * @param {string} token
 */
async function sign(address, token) {
  const headers = { Authorization: `Bearer ${token}`, "Content-Type": "application/json" };
  const body = JSON.stringify({ path: "sound", seconds: LINK_SECONDS });
  const answer = await fetch(address.replace(/sound$/, "links"), { method: "POST", headers, body });
  if (!answer.ok) throw new Error("no right to the sound");
  return (await answer.json()).query;
}
