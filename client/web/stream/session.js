/**
 * The viewer's side of docs/protocol.md without a socket: messages in, messages to send and a status out.
 */

import { heard, nameOf, VERSION } from "./heard.js";
import { LIVE_SECONDS, phaseOf } from "./phase.js";

export const PROTOCOL = "streamlod.v1";
const CLIENT = "streamlod-web/1.0";
const FIRST_WAIT_MS = 500,
  MAX_WAIT_MS = 15_000,
  GROW_AFTER = 3;
const MIN_STALL_MS = 2500; // without a frame
const MAX_STALL_MS = 60_000;
const FIRST_GAP_MS = 2500; // between two frames, as long as only one has come
const USUAL_GAPS = 4; // so many times the usual time between two frames is a stall

/** @typedef {{ epoch: number, version: number }} Position */

/** @typedef {import("./phase.js").Phase} Phase */

/**
 * @typedef {object} Status
 * @property {Phase} phase
 * @property {import("./phase.js").Source} source
 * @property {boolean} loops - a recording that the server begins again at its end
 * @property {number | null} lagSeconds - between the capture times of the newest frame applied and of the newest there is; null where that cannot be told
 * @property {number | null} filmedMs - capture time of the newest frame applied
 * @property {number | null} newestMs - capture time of the newest frame there is
 * @property {number | null} clockMs - what to add to this side's Unix time to have the server's
 * @property {string} detail - the other side's words, may be empty
 * @property {string} stage - of training the first frame, in the server's words, may be empty
 * @property {string} trouble - what a degraded stream or one that starts suffers from, else empty
 * @property {number | null} fraction - of training the first frame
 * @property {{ oldest: Position, newest: Position } | null} window
 * @property {Position | null} position - newest applied
 * @property {{ filmedMs: number, at: number } | null} began - since when it plays on, in ms of this side, and from what; also where that is the picture that was there
 * @property {"live" | "replay" | "paused"} mode
 * @property {boolean} stopping - it stands still, or will where a seek leads
 * @property {number | null} levels - of the stream
 * @property {number | null} sentLevels - that packets carry now
 * @property {number | null} fps - of the stream
 * @property {number} retryAt - time in ms of the next attempt while reconnecting
 * @property {number} skipped - versions not sent one by one
 * @property {number} bytes - received on all connections
 * @property {Together | null} together - null where nobody may present
 */

/**
 * @typedef {object} Together
 * @property {string} session - this viewer's
 * @property {boolean} mayPresent - whether it has the right
 * @property {string | null} by - session of who presents
 * @property {{ position: [number, number, number], rotation: number[], distance: number, focal: number, stretch: number, shift: [number, number] } | null} view - to those who follow
 * @property {{ mode: string, epoch: number, version: number } | { mode: "live" } | null} at
 */

/** Close codes after which another attempt cannot help. @type {Record<number, Phase>} */
const FINAL = {
  1000: "deleted",
  1008: "failed",
  1009: "failed",
  4400: "failed",
  4401: "denied",
  4403: "denied",
  4404: "missing",
  4415: "version",
};

/** @type {(one: Position, other: Position) => boolean} */
const isNewer = (one, other) => one.epoch > other.epoch || (one.epoch === other.epoch && one.version > other.version);

export class Session {
  /** @param {number} now - ms */
  constructor(now) {
    /** @type {Status} */
    this.status = {
      phase: "connecting",
      source: "cameras",
      loops: false,
      lagSeconds: null,
      filmedMs: null,
      newestMs: null,
      clockMs: null,
      detail: "",
      stage: "",
      trouble: "",
      fraction: null,
      window: null,
      position: null,
      began: null,
      mode: "live",
      stopping: false,
      levels: null,
      sentLevels: null,
      fps: null,
      retryAt: 0,
      skipped: 0,
      bytes: 0,
      together: null,
    };
    this.attempts = 0;
    this.open = false;
    /** @type {"opening" | "open" | "broken"} */
    this.link = "opening";
    /** @type {Phase | null} */
    this.verdict = null;
    this.isOver = this.isQuiet = false;
    this.isFresh = false; // a frame has come since the connection was opened
    this.received = 0; // bytes on this connection
    this.ackEvery = 8;
    this.unacknowledged = 0;
    this.lastAck = now;
    this.lastPacket = now;
    this.usualGap = 0; // ms between two frames that arrive
    this.filmedGap = 0; // ms between the capture times of two frames; a keyframe and the change to the newest tell it at once
    this.saidHello = now;
    this.epoch = 0;
    this.streamState = "";
    this.refused = 0; // packets in a row
    this.edges = /** @type {string[]} */ ([]);
    this.leaves = false; // for an edge
    /** @type {{ levels?: number | null, kilobytes_per_second?: number | null }} */
    this.wishes = {};
    /** Where to begin; later on, where the viewer was. @type {"live" | Position} */
    this.start = "live";
    /** Where to begin instead, asked for while there was no connection. @type {"live" | Position | null} */
    this.wanted = null;
  }

  /** The connection stands. @type {(now: number) => object[]} */
  opened(now) {
    this.open = true;
    this.received = this.unacknowledged = 0;
    this.lastAck = this.lastPacket = this.saidHello = now;
    this.isQuiet = this.isFresh = false;
    const { mode, position } = this.status;
    if (position) this.start = mode === "live" ? mode : position;
    this.start = this.wanted ?? this.start;
    this.wanted = null;
    const wishes = Object.fromEntries(Object.entries(this.wishes).filter(([, value]) => value != null));
    return [{ type: "hello", versions: [VERSION], client: CLIENT, start: this.start, ...wishes }];
  }

  /**
   * A control message came; one that cannot be read ends the session (`verdict`).
   * @param {string} text
   * @param {number} now - ms
   * @param {number} unixMs - this side's Unix time
   * @returns {{ mode: "live" | "replay" | "paused", version: number, clamped: boolean } | null} what a position event says
   */
  control(text, now = this.lastPacket, unixMs = NaN) {
    const message = heard(text),
      { status } = this;
    if (!message) {
      this.verdict = "failed";
      status.detail = "the server sent a message that cannot be read";
      this.settle();
      return null;
    }
    switch (nameOf(message)) {
      case "welcome":
        if (message.version !== VERSION) {
          this.verdict = "version";
          break;
        }
        this.attempts = 0;
        this.link = "open";
        this.epoch = message.epoch ?? 0;
        this.leaves = !this.edges.length && message.source === "cameras"; // an edge has not all of the past
        this.edges = message.edges ?? [];
        this.ackEvery = message.ack_every ?? 8;
        Object.assign(status, {
          levels: message.levels,
          sentLevels: message.levels,
          fps: message.fps,
          source: message.source ?? "cameras",
          loops: message.loop === true,
        });
        this.#window(message.window);
        if (message.server_time_ns)
          status.clockMs = message.server_time_ns / 1e6 - (unixMs - (now - this.saidHello) / 2);
        this.#progress(message.progress);
        this.#streamState(message.state, message.detail);
        status.together = message.together && {
          session: message.session ?? "",
          mayPresent: message.together.may_present,
          by: message.together.by ?? null,
          view: null,
          at: null,
        };
        break;
      case "presenter":
        if (status.together)
          Object.assign(status.together, {
            mayPresent: message.may_present ?? status.together.mayPresent,
            by: message.by ?? null,
            view: message.view ?? null,
            at: message.at ?? null,
          });
        break;
      case "state":
        if (this.streamState === "starting") {
          this.lastPacket = now; // no frame was due while the first one was trained
          this.isQuiet = false;
        }
        this.#streamState(message.state, message.detail);
        break;
      case "progress":
        this.#progress(message);
        break;
      case "epoch":
        this.epoch = message.epoch;
        break;
      case "position":
        status.mode = message.mode;
        if (message.epoch != null) this.epoch = message.epoch;
        this.lastPacket = now; // nothing was due while paused
        this.isQuiet = false;
        this.settle();
        return { mode: message.mode, version: message.version, clamped: message.clamped === true };
      case "levels":
        status.sentLevels = message.levels;
        break;
      case "skipped":
        status.skipped += Math.max(0, message.to - message.from - 1) || 0;
        break;
      case "caught_up":
        if (status.mode !== "paused") status.mode = "live";
        break;
      case "draining":
        this.leaves = true;
        break;
      case "window":
        this.#window(message);
        break;
    }
    this.settle();
    return null;
  }

  /** @param {{ oldest: Position, newest: Position, newest_time_ns?: number } | null} told */
  #window(told) {
    this.status.window = told && { oldest: told.oldest, newest: told.newest };
    this.status.newestMs = told?.newest_time_ns == null ? null : told.newest_time_ns / 1e6;
  }

  /** @param {{ fraction?: number, text?: string } | null} told */
  #progress(told) {
    this.status.fraction = told?.fraction ?? null;
    this.status.stage = told?.text ?? "";
  }

  /** @type {(state: string, detail: string) => void} */
  #streamState(state, detail) {
    this.streamState = state;
    this.status.detail = detail ?? "";
    this.status.trouble = ["starting", "degraded"].includes(state) ? this.status.detail : "";
  }

  /** The phase that follows from what is known. */
  settle() {
    const { status } = this,
      { position, window } = status;
    const { filmedMs, newestMs } = status;
    const inEpoch = position && window && position.epoch === window.newest.epoch;
    const versions = inEpoch ? Math.max(0, window.newest.version - position.version) : 0;
    const comparable = inEpoch || status.source === "cameras"; // others begin their times again in each epoch
    const isTimed = position && comparable && filmedMs !== null && newestMs !== null;
    status.lagSeconds = inEpoch && versions === 0 ? 0 : isTimed ? Math.max(0, newestMs - filmedMs) / 1000 : null;
    const isOld = position && window && position.epoch < window.newest.epoch;
    // The newest version may be on its way; an older server tells no times, so that only versions can be counted.
    const isBehind = isOld || (versions > 1 && (status.lagSeconds ?? versions / (status.fps || 30)) > LIVE_SECONDS);
    status.phase = phaseOf({
      link: this.link,
      verdict: this.verdict,
      stream: this.streamState,
      source: status.source,
      mode: status.mode,
      hasFrame: position !== null && (this.isFresh || this.streamState !== "starting"),
      hasWindow: window !== null,
      isOver: this.isOver,
      isBehind: Boolean(isBehind),
      isQuiet: this.isQuiet,
    });
  }

  /** A packet of `size` bytes arrived. @type {(size: number, now: number) => void} */
  arrived(size, now) {
    this.received += size;
    this.status.bytes += size;
    const gap = Math.min(now - this.lastPacket, MAX_STALL_MS);
    // A slow encoder is not a stall, and a burst is no proof of a fast one.
    if (this.status.phase === "live" || this.status.phase === "stalled")
      this.usualGap += (gap - this.usualGap) * (gap > this.usualGap ? 0.5 : 0.1);
    this.lastPacket = now;
    this.isQuiet = false;
  }

  /**
   * The state is at `version` now, filmed at `filmedMs`.
   * @type {(version: number, decodeMs: number, now: number, filmedMs?: number | null) => object[]}
   */
  applied(version, decodeMs, now, filmedMs = null) {
    const { status } = this,
      { position: before, filmedMs: beforeMs } = status,
      position = (status.position = { epoch: this.epoch, version });
    if (before?.epoch === this.epoch && before.version < version && beforeMs !== null && filmedMs !== null)
      this.filmedGap = (filmedMs - beforeMs) / (version - before.version);
    status.filmedMs = filmedMs;
    const { window } = status; // told a little later; what was shown can be sought
    if (window && !isNewer(window.newest, position)) {
      status.window = { ...window, newest: position };
      status.newestMs = filmedMs ?? status.newestMs;
    }
    this.refused = 0;
    this.isFresh = true;
    this.settle();
    this.unacknowledged++;
    if (this.unacknowledged < this.ackEvery && now - this.lastAck < 900) return [];
    return this.acknowledge(decodeMs, now);
  }

  /** @type {(decodeMs: number | null, now: number) => object[]} */
  acknowledge(decodeMs, now) {
    this.unacknowledged = 0;
    this.lastAck = now;
    if (!this.status.position) return [];
    const ack = { type: "ack", bytes: this.received, ...this.status.position };
    return [decodeMs === null ? ack : { ...ack, decode_ms: Number(decodeMs.toFixed(2)) }];
  }

  /** Once in a while: acknowledge what is open, notice silence. @type {(now: number) => object[]} */
  tick(now) {
    const { status } = this;
    if (!this.open) return [];
    // Nobody knows when the next frame of a recording is due that the server plays and has sent all of so far.
    const isDue = status.source !== "recording" || !this.#hasNewest;
    const filmedGap = this.filmedGap || (status.filmedMs === null ? 0 : FIRST_GAP_MS);
    const patience = isDue
      ? Math.max(
          MIN_STALL_MS,
          8000 / (status.fps || 30),
          USUAL_GAPS * Math.max(this.usualGap, filmedGap, this.#gapAhead()),
        )
      : MAX_STALL_MS;
    this.isQuiet = now - this.lastPacket > Math.min(patience, MAX_STALL_MS);
    this.settle();
    return this.unacknowledged && now - this.lastAck > 900 ? this.acknowledge(null, now) : [];
  }

  /** Whether the server has told of nothing newer than what is shown; its word of the newest may come late. */
  get #hasNewest() {
    const { position, window } = this.status;
    return position !== null && (window === null || !isNewer(window.newest, position));
  }

  /** Mean ms between the frames from the one shown to the newest, as far as they are of one run; else 0. */
  #gapAhead() {
    const { position, window, filmedMs, newestMs } = this.status;
    if (!position || window?.newest.epoch !== position.epoch || filmedMs === null || newestMs === null) return 0;
    return Math.max(0, newestMs - filmedMs) / Math.max(1, window.newest.version - position.version);
  }

  /**
   * The connection ended, or could not be made.
   * @param {number} code - 1006 when the network broke
   * @param {string} reason
   * @param {number} now - ms
   * @param {number} random - 0 to 1, the jitter
   * @returns {number | null} ms to wait before the next attempt; null when there is none
   */
  closed(code, reason, now, random) {
    const { status } = this;
    this.open = false;
    const own = this.refused > 0; // left because of a packet
    if (!own && FINAL[code]) {
      this.verdict = FINAL[code];
      status.detail = reason;
      this.settle();
      return null;
    }
    const step = Math.min(FIRST_WAIT_MS * 2 ** Math.max(this.attempts - GROW_AFTER, 0), MAX_WAIT_MS);
    const wait = own && this.refused === 1 ? 0 : step * (0.75 + 0.5 * random);
    this.attempts++;
    this.link = "broken";
    status.detail = reason;
    status.retryAt = now + wait;
    this.settle();
    return wait;
  }
}
