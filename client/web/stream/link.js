/** A websocket that speaks the protocol by a session and is opened again after a break; subclasses take what comes. */

import { PROTOCOL, Session } from "./session.js";

const TICK_MS = 250;

export class Link {
  /** @param {string} url @param {string | null} token */
  constructor(url, token) {
    this.url = url;
    this.protocols = token ? [PROTOCOL, `bearer.${token}`] : [PROTOCOL];
    this.session = new Session(performance.now());
    /** @type {WebSocket | null} */
    this.socket = null;
    this.retry = 0;
    this.home = "";
    this.stays = false; // at home
    this.ticker = setInterval(() => this.#tick(), TICK_MS);
  }

  open() {
    this.home ||= this.url;
    const socket = new WebSocket(this.url, this.protocols);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.opened(this.session.opened(performance.now()));
    socket.onmessage = ({ data }) => socket === this.socket && this.hear(data, socket);
    socket.onclose = ({ code, reason }) => socket === this.socket && this.closed(code, reason);
    this.socket = socket;
  }

  /** The connection stands. @param {object[]} messages - to send first */
  opened(messages) {
    this.transmit(messages);
  }

  /** Something came. @param {string | ArrayBuffer} _data @param {WebSocket} _socket */
  hear(_data, _socket) {}

  /** What is known has changed. */
  tell() {}

  /** @param {number} code @param {string} reason */
  closed(code, reason) {
    if (this.url !== this.home && code > 4400 && code < 4405) {
      // its origin may serve
      this.url = this.home;
      this.stays = true;
      return this.open();
    }
    const wait = this.session.closed(code, reason, performance.now(), Math.random());
    if (wait !== null) this.retry = setTimeout(() => this.#move(), wait);
    this.tell();
  }

  #tick() {
    const before = this.session.status.phase;
    this.transmit(this.session.tick(performance.now()));
    if (this.session.status.phase !== before) this.tell();
    if (this.session.leaves) this.#move();
  }

  /** Go on at the edge that answers first, or where this began. */
  async #move() {
    const { session, socket } = this;
    session.leaves = false;
    const ready = (this.stays ? [] : session.edges).map(async (edge) => {
      if (!(await fetch(edge + "/readyz", { signal: AbortSignal.timeout(2000) })).ok) throw edge;
      return edge.replace("http", "ws") + /\/v1\/.*/.exec(new URL(this.home).pathname)?.[0]; // below the path of a proxy
    });
    const url = await Promise.any(ready).catch(() => this.home);
    if (socket !== this.socket || (url === this.url && socket?.readyState === WebSocket.OPEN)) return;
    this.url = url;
    this.open();
    socket?.close();
  }

  /** @param {object[]} messages */
  transmit(messages) {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    for (const message of messages) this.socket.send(JSON.stringify(message));
  }

  /** Try again at once. */
  hurry() {
    if (this.session.status.phase !== "reconnecting") return;
    clearTimeout(this.retry);
    this.open();
  }

  close() {
    clearInterval(this.ticker);
    clearTimeout(this.retry);
    this.socket?.close(1000);
    this.socket = null;
  }
}
