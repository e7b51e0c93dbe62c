/** The session on a websocket: opens it, keeps order, connects again. */

import { PROTOCOL, Session } from "./session.js";

const TICK_MS = 250;

/**
 * @typedef {object} Handlers
 * @property {(bytes: Uint8Array) => Promise<{ version: number, ms: number } | null>} packet - null where it was refused
 * @property {(effect: { position: boolean, keyframeFollows: boolean }) => void} control
 * @property {() => void} status
 */

export class Connection {
  /** @param {string} url @param {string | null} token @param {Handlers} handlers */
  constructor(url, token, handlers) {
    this.url = url;
    this.protocols = token ? [PROTOCOL, `bearer.${token}`] : [PROTOCOL];
    this.handlers = handlers;
    this.session = new Session(performance.now());
    /** @type {(string | Uint8Array)[]} */
    this.queue = [];
    this.busy = false;
    this.ended = false;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.retry = 0;
    this.ticker = setInterval(() => this.#tick(), TICK_MS);
    this.#open();
  }

  #open() {
    const socket = new WebSocket(this.url, this.protocols);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.send(this.session.opened(performance.now()));
    socket.onmessage = ({ data }) => {
      if (socket !== this.socket) return;
      if (typeof data !== "string") this.session.arrived(data.byteLength, performance.now());
      this.queue.push(typeof data === "string" ? data : new Uint8Array(data));
      this.#drain();
    };
    socket.onclose = ({ code, reason }) => socket === this.socket && this.#closed(code, reason);
    this.socket = socket;
  }

  /** Handle what came, in order; packets take time. */
  async #drain() {
    if (this.busy) return;
    this.busy = true;
    for (let item; (item = this.queue.shift()) !== undefined; ) {
      const socket = this.socket;
      if (typeof item === "string") {
        const effect = this.session.control(item);
        this.handlers.control(effect);
      } else {
        const applied = await this.handlers.packet(item);
        if (socket !== this.socket) continue;
        if (applied) this.send(this.session.applied(applied.version, applied.ms, performance.now()));
        else this.#refuse();
      }
      this.handlers.status();
    }
    this.busy = false;
  }

  /** A packet did not fit: leave and come again. */
  #refuse() {
    this.queue.length = 0;
    const code = this.session.refuse();
    const socket = this.socket;
    this.socket = null;
    socket?.close(code, "a packet was refused");
    this.#closed(code, "a packet was damaged");
  }

  /** @param {number} code @param {string} reason */
  #closed(code, reason) {
    if (this.ended) return;
    const wait = this.session.closed(code, reason, performance.now(), Math.random());
    if (wait !== null) this.retry = self.setTimeout(() => this.#open(), wait);
    this.handlers.status();
  }

  #tick() {
    const before = this.session.status.phase;
    this.send(this.session.tick(performance.now()));
    if (this.session.status.phase !== before) this.handlers.status();
  }

  /** @param {object[]} messages */
  send(messages) {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    for (const message of messages) this.socket.send(JSON.stringify(message));
  }

  /** Try again at once. */
  hurry() {
    if (this.session.status.phase !== "reconnecting") return;
    clearTimeout(this.retry);
    this.#open();
  }

  close() {
    this.ended = true;
    clearInterval(this.ticker);
    clearTimeout(this.retry);
    this.socket?.close(1000);
    this.socket = null;
  }
}
