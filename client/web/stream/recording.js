/** Plays a `.slod` file over HTTP Range requests; takes the same commands as a connection. */

import { FOOTER, levelOf, moments, plan, readFooter, readIndex, walkRecords } from "../decode/container.js";
import { KEY, LIMITS, must } from "../decode/packet.js";
import { Session } from "./session.js";

/** @typedef {import("./connection.js").Handlers} Handlers */
/** @typedef {import("../decode/container.js").Entry} Entry */

const MAX_AHEAD = 1 << 19, MAX_READ = 1 << 30, CACHE_BYTES = 96 << 20, TICK_MS = 8;
const AHEAD_MS = 500; // how long a request may take
const LATE_MS = 300; // a keyframe that takes longer is shown level by level
const STALL_MS = 1000; // that a frame is waited for

/** Bytes of one address, by range where the server can, whole where it cannot. */
class RangeReader {
  /** @param {string} url @param {string | null} token - where the server asks for one */
  constructor(url, token) {
    this.url = url;
    /** @type {Record<string, string>} */
    this.headers = token ? { Authorization: `Bearer ${token}` } : {};
    /** @type {Uint8Array | null} */
    this.whole = null;
    this.size = 0;
  }

  /** @param {string} range @returns {Promise<Response>} */
  async #fetch(range) {
    const { origin } = new URL(this.url);
    const answer = await fetch(this.url, { headers: { ...this.headers, Range: `bytes=${range}` } }).catch(() => {
      throw new Error(`${origin} does not answer${origin === location.origin ? "" : ", or does not let pages of other sites read its files (CORS)"}`);
    });
    if (!answer.ok) throw new Error(`the recording cannot be read: ${answer.status} ${answer.statusText}`);
    return answer;
  }

  /** The last `n` bytes; learns the size. @param {number} n */
  async tail(n) {
    const answer = await this.#fetch(`-${n}`);
    const bytes = new Uint8Array(await answer.arrayBuffer());
    if (answer.status === 206) {
      const total = /\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "");
      if (!total) throw new Error("the file's server hides the header Content-Range from pages of other sites (CORS): it must expose it");
      this.size = Number(total[1]);
    } else this.#keep(bytes);
    return bytes.subarray(Math.max(0, bytes.length - n));
  }

  /** @param {Uint8Array} bytes */
  #keep(bytes) {
    this.whole = bytes;
    this.size = bytes.length;
  }

  /** A range, each time as much of it as has come. @param {number} start @param {number} end @returns {AsyncGenerator<Uint8Array, void>} */
  async *arriving(start, end) {
    if (!this.whole) {
      const answer = await this.#fetch(`${start}-${end - 1}`);
      if (answer.status !== 206 || !answer.body) this.#keep(new Uint8Array(await answer.arrayBuffer()));
      else {
        must(end - start <= MAX_READ, "limit_exceeded", "the recording has no index and is too long to be read without");
        const bytes = new Uint8Array(end - start), reader = answer.body.getReader();
        for (let at = 0, more; !(more = await reader.read()).done; ) {
          bytes.set(more.value, at);
          yield bytes.subarray(0, (at += more.value.length));
        }
        return;
      }
    }
    yield /** @type {Uint8Array} */ (this.whole).subarray(start, end);
  }

  /** @param {number} start @param {number} end @returns {Promise<Uint8Array>} */
  async read(start, end) {
    /** @type {Uint8Array} */
    let bytes = new Uint8Array(0);
    for await (bytes of this.arriving(start, end));
    must(bytes.length === end - start, "truncated", "the recording ends too early");
    return bytes;
  }
}

export class Recording {
  /** @param {string} url @param {string | null} token @param {Handlers} handlers @param {boolean} loop - begin again at the end */
  constructor(url, token, handlers, loop) {
    this.handlers = handlers;
    this.token = token;
    this.session = new Session(performance.now());
    Object.assign(this.session.status, { source: "recording", mode: "replay", loops: loop });
    this.reader = new RangeReader(url, token);
    /** @type {Entry[]} */
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
    const tail = await this.reader.tail(FOOTER);
    const { size } = this.reader;
    const footer = readFooter(tail, size);
    const index = footer && readIndex(await this.reader.read(footer.start, size - FOOTER), footer.checksum, footer.start);
    this.entries = index ?? walkRecords(await this.reader.read(0, size));
    this.moments = moments(this.entries);
    must(this.moments.length, "bad_file", "the recording is empty or not a .slod file");
    const oldest = { epoch: 1, version: this.moments[0].version };
    const newest = { epoch: 1, version: this.moments[this.moments.length - 1].version };
    const { session } = this;
    session.link = "open";
    session.status.window = { oldest, newest };
    session.settle();
    this.#moveTo(0);
  }

  /** @param {unknown} error */
  #fail(error) {
    if (this.ended) return;
    this.session.verdict = "failed";
    this.session.status.detail = error instanceof Error ? error.message : String(error);
    this.session.settle();
    clearInterval(this.ticker);
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
    this.clock = { wall: performance.now(), media: this.moments[this.at]?.timeMs ?? 0 };
  }

  #tick() {
    if (!this.moments.length || this.ended) return;
    if (this.busy) return this.#settle();
    if (this.playing && this.shown >= 0) {
      const media = this.clock.media + (performance.now() - this.clock.wall) * this.speed;
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
      this.#show(this.at).catch((error) => this.#fail(error)).finally(() => (this.busy = false));
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
    if (this.shown < 0) this.#moveTo(index);
    this.shown = index;
    this.session.status.position = { epoch: 1, version };
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
      for (let part; level < LIMITS.levels && (part = levelOf(bytes, level)); level++) if (part.length) await this.#apply(part);
    }
  }

  /** @param {Uint8Array} packet */
  async #apply(packet) {
    must(await this.handlers.packet(packet), "bad_file", "the recording is damaged");
  }

  /** What has come of one packet, until it is whole, reading on a little where it is not there yet. @param {number} number @returns {AsyncGenerator<Uint8Array, void>} */
  async *#packet(number) {
    const known = this.cache.get(number);
    if (known) return yield known;
    const first = this.entries[number], begin = performance.now();
    let last = number, end = first.offset + first.size;
    while (last + 1 < this.entries.length && this.entries[last + 1].offset === end + 4 && end - first.offset < this.ahead) {
      last++;
      end = this.entries[last].offset + this.entries[last].size;
    }
    /** @type {Uint8Array} */
    let bytes = new Uint8Array(0);
    for await (bytes of this.reader.arriving(first.offset, end)) if (bytes.length < first.size) yield bytes;
    must(bytes.length === end - first.offset, "truncated", "the recording ends too early");
    this.ahead = Math.min(MAX_AHEAD, (bytes.length * AHEAD_MS) / (performance.now() - begin + 1));
    for (let i = number; i <= last; i++) {
      const { offset, size } = this.entries[i];
      if (!this.cache.has(i)) this.cached += size;
      this.cache.set(i, bytes.slice(offset - first.offset, offset - first.offset + size));
    }
    for (const [i, old] of this.cache) {
      if (this.cached <= CACHE_BYTES || i === number) break;
      this.cache.delete(i);
      this.cached -= old.length;
    }
    yield /** @type {Uint8Array} */ (this.cache.get(number));
  }

  #settle() {
    const { session } = this, { status } = session, { phase, mode } = status;
    session.isOver = !this.playing && this.shown === this.moments.length - 1;
    session.isQuiet = this.busy && performance.now() - this.wantedAt > STALL_MS;
    status.mode = this.playing || session.isOver ? "replay" : "paused";
    session.settle();
    if (status.phase !== phase || status.mode !== mode) this.handlers.status();
  }

  /** Commands as on a connection, and speed and loop. @param {any[]} messages */
  send(messages) {
    for (const message of messages) {
      if (message.type === "seek") this.#moveTo(message.to === "live" ? this.moments.length - 1 : this.#indexOf(message.to.version));
      else if (message.type === "pause") this.playing = false;
      else if (message.type === "play") {
        this.#moveTo(this.at >= this.moments.length - 1 ? 0 : this.at);
        this.playing = true;
      } else if (message.type === "speed") {
        this.#moveTo(this.at);
        this.speed = message.value;
      } else if (message.type === "loop") this.loop = message.value;
    }
  }

  hurry() {}

  close() {
    this.ended = true;
    clearInterval(this.ticker);
  }
}
