/** The session of a viewer that decodes: keeps packets and commands in order. */

import { Link } from "./link.js";

/**
 * @typedef {object} Handlers
 * @property {(bytes: Uint8Array) => Promise<{ version: number, ms: number, filmedMs: number } | null>} packet - null where it was refused
 * @property {(version: number | null) => void} hold - show no picture before this version is reached; null: show what there is
 * @property {() => void} status
 * @property {(piece: ArrayBuffer) => void} [sound] - a piece that came beside the packets
 * @property {(moments: { version: number, timeMs: number }[]) => void} [moments] - all that a file holds
 */

export class Connection extends Link {
  /** @param {string} url @param {string | null} token @param {Handlers} handlers */
  constructor(url, token, handlers) {
    super(url, token);
    this.token = token;
    this.handlers = handlers;
    /** @type {(string | Uint8Array)[]} */
    this.queue = [];
    this.busy = false;
    this.ended = false;
    this.speed = 1;
    this.sound = false; // wanted
    this.frozen = false; // paused: packets still on their way are not applied
    this.asked = true; // for a place, and not answered: packets belong to where we were
    /** @type {number | null} version at which to pause */
    this.stopAt = null;
    /** @type {number | null} version that a seek leads to */
    this.aim = null;
    this.open();
  }

  open() {
    const {
      wanted,
      status: { mode, position },
    } = this.session;
    this.asked = true;
    this.frozen = false;
    if (!wanted) {
      this.aim = null;
      this.stopAt = mode === "paused" && position ? position.version : null;
    }
    super.open();
  }

  /** @param {object[]} messages */
  opened(messages) {
    super.opened(
      this.speed === 1 && !this.sound ? messages : [...messages, { type: "set", speed: this.speed, sound: this.sound }],
    );
  }

  /** Whether sound is wanted from now on. @param {boolean} on */
  listen(on) {
    this.sound = on;
    this.transmit([{ type: "set", sound: on }]);
  }

  /** @param {string | ArrayBuffer} data */
  hear(data) {
    if (typeof data !== "string" && isSound(data)) return this.handlers.sound?.(data);
    if (typeof data !== "string") this.session.arrived(data.byteLength, performance.now());
    this.queue.push(typeof data === "string" ? data : new Uint8Array(data));
    this.#drain();
  }

  tell() {
    this.handlers.status();
  }

  /** Whether it stands still, or will where a seek leads. */
  get stopping() {
    return this.frozen || this.stopAt !== null;
  }

  /** Handle what came, in order; packets take time. */
  async #drain() {
    if (this.busy) return;
    this.busy = true;
    for (let item; !this.ended && (item = this.queue.shift()) !== undefined;) {
      const socket = this.socket;
      if (typeof item === "string") this.#control(item);
      else if (!this.frozen && !this.asked) {
        const applied = await this.handlers.packet(item);
        if (socket !== this.socket) continue;
        if (applied) this.send(this.session.applied(applied.version, applied.ms, performance.now(), applied.filmedMs));
        else this.#refuse();
        this.#stop();
      }
      this.handlers.status();
    }
    this.busy = false;
  }

  /** @param {string} text */
  #control(text) {
    const told = this.session.control(text, performance.now(), Date.now());
    if (this.session.verdict) this.close();
    if (!told) return;
    this.asked = false;
    if (told.mode === "paused") this.handlers.hold(null);
    if (told.clamped) {
      if (this.stopAt !== null) this.stopAt = told.version;
      if (this.aim !== null) this.aim = told.version;
      this.handlers.hold(told.version);
    }
    this.#stop();
  }

  /** Pause where that was asked for. */
  #stop() {
    const { mode, position } = this.session.status;
    if (this.asked || !position) return;
    /** @type {(to: number | null) => boolean} live goes on past it */
    const reached = (to) => position.version === to || (to !== null && mode === "live" && position.version > to);
    if (reached(this.aim)) {
      this.aim = null;
      const { filmedMs } = this.session.status;
      this.session.status.began = filmedMs === null ? null : { filmedMs, at: performance.now() };
    }
    if (!reached(this.stopAt)) return;
    this.stopAt = null;
    this.transmit([{ type: "pause" }]);
    this.frozen = true;
  }

  /** A packet did not fit: leave and come again. */
  #refuse() {
    this.queue.length = 0;
    const socket = this.socket;
    this.session.refused++;
    this.socket = null;
    socket?.close(4400, "a packet was refused");
    this.closed(4400, "a packet was damaged");
  }

  /** Commands of the protocol; a seek with `stop` pauses on arrival. @param {any[]} messages */
  send(messages) {
    const { position, window } = this.session.status;
    for (const { stop, ...wanted } of messages) {
      if (wanted.type === "speed") this.speed = wanted.value;
      const isPlay = wanted.type === "play",
        isPause = wanted.type === "pause";
      // The server stopped a few packets after what is shown: to go on is a seek.
      const message =
        isPlay && position
          ? { type: "seek", to: position }
          : wanted.type === "speed"
            ? { type: "set", speed: wanted.value }
            : wanted;
      if (this.aim !== null && (isPlay || isPause)) {
        this.stopAt = isPause ? this.aim : null; // where the seek leads
        continue;
      }
      if (!this.session.open && (isPlay || isPause || message.type === "seek")) {
        this.#want(isPlay || isPause ? (this.session.wanted ?? position) : message.to, Boolean(stop) || isPause);
        continue;
      }
      if (isPlay || message.type === "seek") {
        this.frozen = false;
        this.asked = true;
        this.aim = message.to?.version ?? null;
        this.stopAt = stop ? this.aim : null;
        if (message.to) this.handlers.hold(this.aim ?? window?.newest.version ?? null);
      }
      if (isPause) this.frozen = true;
      this.transmit([message]);
    }
  }

  /**
   * Begin there once there is a connection.
   * @param {"live" | import("./session.js").Position | null} to
   * @param {boolean} stop
   */
  #want(to, stop) {
    this.session.wanted = to;
    this.aim = to === "live" ? null : (to?.version ?? null);
    this.stopAt = stop ? this.aim : null;
  }

  close() {
    this.ended = true;
    super.close();
  }
}

const FTYP = 0x66747970; // the kind of the first box of MP4, where a packet says how it is made

/** Whether a message is a piece of sound. @param {ArrayBuffer} data */
const isSound = (data) => data.byteLength > 8 && new DataView(data).getUint32(4) === FTYP;
