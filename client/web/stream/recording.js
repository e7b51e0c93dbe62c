/** Plays a `.slod` file over HTTP Range requests; takes the same commands as a connection. */

import { checkEntry, levelOf, moments, plan } from "../decode/container.js";
import { KEY, LIMITS, must } from "../decode/packet.js";
import { BitstreamError } from "../decode/scene.js";
import { FileReader } from "./file.js";
import { Session } from "./session.js";

const MAX_AHEAD = 1 << 19,
  CACHE_BYTES = 96 << 20,
  TICK_MS = 8;
const AHEAD_MS = 500; // how long a request may take
const LATE_MS = 300; // a keyframe that takes longer is shown level by level
const DAMAGED = "a part of the file is damaged or missing";
const STALL_MS = 1000; // that a frame is waited for
const MAX_GAP_MS = 10_000; // nobody waits longer where nothing was filmed; as core/gaps.py

export class Recording {
  /**
   * @param {string} url
   * @param {string | null} token
   * @param {import("./connection.js").Handlers} handlers
   * @param {boolean} loop - begin again at the end
   */
  constructor(url, token, handlers, loop) {
    this.handlers = handlers;
    this.token = token;
    this.session = new Session(performance.now());
    Object.assign(this.session.status, { source: "recording", mode: "replay", loops: loop });
    this.reader = new FileReader(url, token);
    /** @type {import("../decode/container.js").Entry[]} */
    this.entries = [];
    /** @type {{ version: number, timeMs: number }[]} */
    this.moments = [];
    /** @type {Map<number, Uint8Array>} */
    this.cache = new Map();
    this.cached = 0;
    this.ahead = 0; // bytes that are read along, as many as come in AHEAD_MS
    /** @type {{ keyframe: number, version: number } | null} */
    this.held = null;
    this.playing = true;
    this.stopping = false; // what stands still is known at once
    this.loop = loop;
    this.speed = 1;
    this.at = 0; // index of the moment to show
    this.shown = -1;
    this.clock = { wall: 0, media: 0 };
    this.busy = false;
    this.wantedAt = 0; // when the frame that is fetched was asked for
    this.ended = false;
    this.ticker = setInterval(() => this.#tick(), TICK_MS);
    this.#load().catch((error) => this.#fail(error));
  }

  async #load() {
    this.entries = await this.reader.entries();
    this.moments = moments(this.entries);
    must(this.moments.length, "bad_file", "the recording is empty or not a .slod file");
    const oldest = { epoch: 1, version: this.moments[0].version };
    const newest = { epoch: 1, version: this.moments[this.moments.length - 1].version };
    const { session } = this;
    session.link = "open";
    session.status.window = { oldest, newest };
    if (this.reader.isCut) session.status.trouble = DAMAGED;
    session.settle();
    this.#moveTo(0);
    this.handlers.moments?.(this.moments);
    this.handlers.status();
  }

  /** @param {unknown} error */
  #fail(error) {
    if (this.ended) return;
    this.session.verdict = this.token && Object(error).isRefused ? "denied" : "failed";
    this.session.status.detail = error instanceof Error ? error.message : String(error);
    this.session.settle();
    clearInterval(this.ticker);
    this.handlers.status();
  }

  /** A moment cannot be shown: go on after it, from the next keyframe, or end before it. @param {unknown} error */
  #leaveOut(error) {
    const { session } = this,
      { version } = this.moments[this.at];
    const next = this.entries.find(({ kind, keyframe }) => kind === KEY && keyframe > version)?.keyframe ?? Infinity;
    const whole = this.moments.filter((moment) => moment.version < version || moment.version >= next);
    if (!whole.length || !(error instanceof BitstreamError)) return this.#fail(error);
    this.moments = whole;
    session.status.trouble = DAMAGED;
    session.status.window = {
      oldest: { epoch: 1, version: whole[0].version },
      newest: { epoch: 1, version: whole[whole.length - 1].version },
    };
    this.shown = whole.findIndex((moment) => moment.version === this.held?.version);
    if (next === Infinity) this.playing = false;
    this.#moveTo(next === Infinity ? whole.length - 1 : this.#indexOf(next));
    this.handlers.moments?.(whole);
    this.handlers.status();
  }

  /** @param {number} version */
  #indexOf(version) {
    const after = this.moments.findIndex((moment) => moment.version > version);
    return after < 0 ? this.moments.length - 1 : Math.max(0, after - 1);
  }

  /** @param {number} index */
  #moveTo(index) {
    this.at = Math.min(Math.max(index, 0), this.moments.length - 1);
    this.#goOn(this.moments[this.at]?.timeMs ?? 0);
  }

  /** What was filmed that is played now, ms. */
  get #media() {
    return this.clock.media + (performance.now() - this.clock.wall) * this.speed;
  }

  /** Play on from there. @param {number} media - ms of filming */
  #goOn(media) {
    this.clock = { wall: performance.now(), media };
    this.session.status.began = { filmedMs: media, at: this.clock.wall };
  }

  #tick() {
    if (!this.moments.length || this.ended) return;
    if (this.busy) return this.#settle();
    if (this.playing && this.shown >= 0) {
      const next = this.moments[this.at + 1];
      if (next && next.timeMs - this.#media > MAX_GAP_MS) this.#goOn(next.timeMs - MAX_GAP_MS);
      const media = this.#media;
      while (this.at + 1 < this.moments.length && this.moments[this.at + 1].timeMs <= media) this.at++;
      const last = this.moments.length - 1;
      const frame = last > 0 ? (this.moments[last].timeMs - this.moments[0].timeMs) / last : 0;
      if (this.at === last && media > this.moments[last].timeMs + frame) {
        if (this.loop) this.#moveTo(0);
        else this.playing = false;
      }
    }
    if (this.at !== this.shown) {
      this.busy = true;
      this.wantedAt = performance.now();
      this.#show(this.at)
        .catch((error) => this.#leaveOut(error))
        .finally(() => (this.busy = false));
    }
    this.#settle();
  }

  /** @param {number} index */
  async #show(index) {
    const { version } = this.moments[index];
    for (const number of plan(this.entries, version, this.held)) {
      await this.#take(number);
      const entry = this.entries[number];
      this.held = { keyframe: entry.keyframe, version: entry.toVersion };
      this.session.status.bytes += entry.size;
    }
    if (this.shown < 0) this.#moveTo(this.at); // time begins now, where a seek may have led while the keyframe came
    this.shown = index;
    this.session.status.position = { epoch: 1, version };
    this.session.status.filmedMs = this.moments[index].timeMs;
    this.handlers.status();
  }

  /** Decode a packet; a keyframe that is long in coming level by level, coarse ones first. @param {number} number */
  async #take(number) {
    const { kind, size } = this.entries[number];
    let level = 0;
    for await (const bytes of this.#packet(number)) {
      if (level === 0 && bytes.length === size) return this.#apply(bytes);
      const isLate = kind === KEY && (this.shown < 0 || performance.now() - this.wantedAt > LATE_MS);
      if (!isLate && level === 0) continue;
      for (let part; level < LIMITS.levels && (part = levelOf(bytes, level)); level++)
        if (part.length) await this.#apply(part);
    }
  }

  /** @param {Uint8Array} packet */
  async #apply(packet) {
    must(await this.handlers.packet(packet), "bad_file", "the recording is damaged");
  }

  /**
   * What has come of one packet, until it is whole, reading on a little.
   * @param {number} number
   * @returns {AsyncGenerator<Uint8Array, void>}
   */
  async *#packet(number) {
    const known = this.cache.get(number);
    if (known) return yield known;
    const first = this.entries[number],
      begin = performance.now();
    let last = number,
      end = first.offset + first.size;
    while (
      last + 1 < this.entries.length &&
      this.entries[last + 1].offset === end + 4 &&
      end - first.offset < this.ahead
    ) {
      last++;
      end = this.entries[last].offset + this.entries[last].size;
    }
    /** @type {Uint8Array} */
    let bytes = new Uint8Array(0);
    for await (bytes of this.reader.arriving(first.offset, end)) {
      checkEntry(first, bytes);
      if (bytes.length < first.size) yield bytes;
    }
    must(bytes.length === end - first.offset, "truncated", "the recording ends too early");
    this.ahead = Math.min(MAX_AHEAD, (bytes.length * AHEAD_MS) / (performance.now() - begin + 1));
    for (let i = number; i <= last; i++) {
      const { offset, size } = this.entries[i],
        packet = bytes.slice(offset - first.offset, offset - first.offset + size);
      checkEntry(this.entries[i], packet);
      if (!this.cache.has(i)) this.cached += size;
      this.cache.set(i, packet);
    }
    for (const [i, old] of this.cache) {
      if (this.cached <= CACHE_BYTES || i === number) break;
      this.cache.delete(i);
      this.cached -= old.length;
    }
    yield /** @type {Uint8Array} */ (this.cache.get(number));
  }

  #settle() {
    const { session } = this,
      { status } = session,
      { phase, mode } = status;
    session.isOver = !this.playing && this.shown === this.moments.length - 1;
    session.isQuiet = this.busy && performance.now() - this.wantedAt > STALL_MS;
    status.mode = this.playing || session.isOver ? "replay" : "paused";
    session.settle();
    if (status.phase !== phase || status.mode !== mode) this.handlers.status();
  }

  /** Commands as on a connection, and speed and loop. @param {any[]} messages */
  send(messages) {
    for (const message of messages) {
      if (message.type === "seek")
        this.#moveTo(message.to === "live" ? this.moments.length - 1 : this.#indexOf(message.to.version));
      else if (message.type === "pause") {
        if (this.playing) this.#goOn(this.#media);
        this.playing = false;
      } else if (message.type === "play") {
        if (this.at >= this.moments.length - 1) this.#moveTo(0);
        else if (!this.playing) this.#goOn(this.clock.media);
        this.playing = true;
      } else if (message.type === "speed") {
        if (this.playing) this.#goOn(this.#media);
        this.speed = message.value;
      } else if (message.type === "loop") this.loop = message.value;
    }
    this.handlers.status();
  }

  hurry() {}

  close() {
    this.ended = true;
    clearInterval(this.ticker);
  }
}
