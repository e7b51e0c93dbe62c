/** Sends a camera's pictures to the ingest websocket of docs/ingest.md, and drops those for which the line is too slow. */

import { ServerClock } from "./clock.js";

export const PROTOCOL = "streamlod.push.v1";
const FIRST_WAIT_MS = 250,
  MAX_WAIT_MS = 5000;
const FIRST_QUESTIONS = 8,
  QUESTION_MS = 5000; // about the time: at first one after the other, then so far apart
const MAX_UNANSWERED_MS = 400; // what waits longer is not worth adding to
const MAX_BUFFERED_BYTES = 128 * 1024;
const SILENCE_MS = 15_000; // of the server, after which a connection counts as dead
/** Close codes after which another attempt cannot help. */
const FINAL = new Set([1008, 1009, 4400, 4401, 4403, 4404, 4415]);

/** @typedef {{ name: string, width: number, height: number, taken: boolean, sound?: boolean, complaint?: string, board?: { seen: boolean, needs: string } }} WantedCamera */
/** @typedef {"jpeg" | "h264" | "opus" | "pcm"} Codec */
const SOUND = new Set(["opus", "pcm"]);

/**
 * One message: the length of the header, the header in msgpack, the picture.
 * @param {string} camera - of ASCII characters
 * @param {number} sequence
 * @param {number} captureMs - Unix time
 * @param {Codec} codec
 * @param {Uint8Array} picture
 */
export function pack(camera, sequence, captureMs, codec, picture) {
  const text = (/** @type {string} */ value) => [0xd9, value.length, ...new TextEncoder().encode(value)];
  const number = (/** @type {bigint} */ value) => {
    const bytes = new Uint8Array(9);
    bytes[0] = 0xcf;
    new DataView(bytes.buffer).setBigUint64(1, value);
    return bytes;
  };
  const captureNs = BigInt(Math.round(captureMs * 1000)) * 1000n; // browsers' clocks have microseconds
  const header = [
    0x84,
    ...text("camera"),
    ...text(camera),
    ...text("sequence"),
    ...number(BigInt(sequence)),
    ...text("capture_ns"),
    ...number(captureNs),
    ...text("codec"),
    ...text(codec),
  ];
  const message = new Uint8Array(2 + header.length + picture.length);
  message.set([header.length >> 8, header.length & 255, ...header]);
  message.set(picture, 2 + header.length);
  return message;
}

export class PushLink {
  /**
   * @param {string} url
   * @param {string | null} token
   * @param {() => void} changed - called when state, cameras or refusals are others
   */
  constructor(url, token, changed) {
    this.url = url;
    this.protocols = token ? [PROTOCOL, `bearer.${token}`] : [PROTOCOL];
    this.changed = changed;
    /** @type {"connecting" | "open" | "waiting" | "ended"} */
    this.state = "connecting";
    this.detail = ""; // the server's words
    this.isDenied = false; // for its token or link
    this.retryAt = 0;
    this.fps = 30;
    /** @type {WantedCamera[]} */
    this.cameras = [];
    this.clock = new ServerClock();
    this.counts = { sent: 0, taken: 0, refused: 0, dropped: 0, bytes: 0 };
    this.refusals = 0; // of pictures, since the last one that was taken; sound that is refused costs none
    this.refusal = ""; // the newest one's reason
    this.connections = 0;
    this.sequence = 0;
    this.attempts = 0;
    this.heardAt = 0;
    /** @type {{ at: number, heard: boolean }[]} when the messages without an answer were sent, and which are sound */
    this.underWay = [];
    /** @type {(() => void)[]} */
    this.asking = [];
    /** @type {WebSocket | null} */
    this.socket = null;
    this.timer = 0;
    this.ticker = setInterval(() => this.#tick(), QUESTION_MS);
    this.open();
  }

  open() {
    this.clock = new ServerClock(); // it may be another server now
    const socket = new WebSocket(this.url, this.protocols);
    socket.onopen = () => {
      this.heardAt = performance.now();
      this.ask({ type: "cameras" });
    };
    socket.onmessage = ({ data }) => socket === this.socket && this.#hear(JSON.parse(data));
    socket.onclose = ({ code, reason }) => socket === this.socket && this.#closed(code, reason);
    this.socket = socket;
  }

  /** Whether a picture taken now would arrive in time. */
  get hasRoom() {
    const [oldest] = this.underWay;
    return (
      this.state === "open" &&
      (oldest === undefined || performance.now() - oldest.at < MAX_UNANSWERED_MS) &&
      (this.socket?.bufferedAmount ?? 0) < MAX_BUFFERED_BYTES
    );
  }

  /** @param {string} camera @param {number} captureMs - local @param {Codec} codec @param {Uint8Array} picture */
  send(camera, captureMs, codec, picture) {
    if (this.state !== "open" || this.socket?.readyState !== WebSocket.OPEN) return;
    const message = pack(camera, this.sequence++, this.clock.at(captureMs), codec, picture);
    this.socket.send(message);
    this.underWay.push({ at: performance.now(), heard: SOUND.has(codec) });
    this.counts.sent++;
    this.counts.bytes += message.length;
  }

  /** @param {object} question */
  ask(question) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(question));
  }

  /** Waits for the answer; a connection that opens asks by itself. @returns {Promise<void>} */
  askCameras() {
    return new Promise((resolve) => {
      if (!this.socket) return resolve();
      this.asking.push(resolve);
      this.ask({ type: "cameras" });
    });
  }

  /** Connect anew: the server keeps a name for the connection that sent it, as long as that lasts. */
  renew() {
    const socket = this.socket;
    if (this.state !== "open" || !socket) return;
    this.counts.dropped += this.underWay.length;
    this.underWay = [];
    this.refusals = this.counts.refused = 0; // perhaps of another name
    this.state = "connecting";
    this.open();
    socket.close(1000);
  }

  close() {
    clearInterval(this.ticker);
    clearTimeout(this.timer);
    const socket = this.socket;
    this.socket = null;
    this.state = "ended";
    socket?.close(1000);
  }

  /** @param {any} answer */
  #hear(answer) {
    const now = performance.now();
    this.heardAt = now;
    if (answer.type === "time") {
      this.clock.add(answer.sent, now, answer.server_ns / 1e6);
      if (this.clock.count < FIRST_QUESTIONS) this.ask({ type: "time", sent: now });
      else if (this.state === "connecting") this.#stand();
    } else if (answer.type === "cameras") {
      this.fps = answer.fps;
      this.cameras = answer.cameras;
      if (this.state === "connecting") this.ask({ type: "time", sent: performance.now() });
      for (const resolve of this.asking.splice(0)) resolve();
      this.changed();
    } else {
      const heard = this.underWay.shift()?.heard;
      const taken = answer.type === "ack";
      this.counts[taken ? "taken" : "refused"]++;
      if (!heard) this.refusals = taken ? 0 : this.refusals + 1;
      if (!taken) {
        this.refusal = String(answer.reason);
        this.changed();
      }
    }
  }

  #stand() {
    this.state = "open";
    this.detail = "";
    this.attempts = this.refusals = 0;
    this.connections++;
    this.changed();
  }

  #tick() {
    if (this.state === "open") this.ask({ type: "time", sent: performance.now() });
    if (this.socket?.readyState === WebSocket.OPEN && performance.now() - this.heardAt > SILENCE_MS) {
      const socket = this.socket;
      this.#closed(1006, "the server is silent");
      socket.close();
    }
  }

  /** @param {number} code @param {string} reason */
  #closed(code, reason) {
    this.socket = null;
    for (const resolve of this.asking.splice(0)) resolve();
    this.counts.dropped += this.underWay.length;
    this.underWay = [];
    this.isDenied = code === 4401;
    this.detail = reason || (code === 1006 ? "no connection" : `the server closed with code ${code}`);
    if (FINAL.has(code)) {
      this.state = "ended";
      clearInterval(this.ticker);
    } else {
      this.state = "waiting";
      const wait = Math.min(MAX_WAIT_MS, FIRST_WAIT_MS * 2 ** this.attempts++) * (0.5 + Math.random() / 2);
      this.retryAt = performance.now() + wait;
      this.timer = window.setTimeout(() => {
        this.state = "connecting";
        this.open();
      }, wait);
    }
    this.changed();
  }
}
