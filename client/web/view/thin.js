/**
 * Thin mode: the server draws, this side shows its pictures and says where it stands (docs/protocol.md section 2).
 *
 * `ThinLink` takes the place of the worker and `Screen` that of the renderer, so the rest of the page is the same.
 */

import { heard, nameOf } from "../stream/heard.js";
import { Link } from "../stream/link.js";
import { centre } from "../lib/vectors.js";
import { Surface } from "./surface.js";

/** @typedef {import("./messages.js").FromWorker} FromWorker */
/** @typedef {import("./surface.js").View} View */

const HEADER_BYTES = 24;
const VIEW_MS = 50; // between two views that are told
const HOLD_MS = 1500;

/** @param {HTMLCanvasElement} canvas @throws {Error} where not even a flat canvas can be had */
export function createThin(canvas) {
  const link = new ThinLink();
  return { renderer: new Screen(canvas, link), worker: link };
}

/** Shows the newest picture. The background that a viewer chose has no effect: the server draws. */
class Screen extends Surface {
  /** @param {HTMLCanvasElement} canvas @param {ThinLink} link */
  constructor(canvas, link) {
    super(canvas);
    const context = canvas.getContext("2d", { alpha: false });
    if (!context) throw new Error("no canvas");
    this.api = this.hardware = "server";
    this.context = context;
    this.link = link;
  }

  /** @param {View} view */
  draw(view) {
    const { context, link } = this,
      { width, height } = this.canvas;
    context.fillStyle = `rgb(${this.background.map((x) => Math.round(255 * x)).join(" ")})`;
    context.fillRect(0, 0, width, height);
    if (link.bitmap) context.drawImage(link.bitmap, 0, 0, width, height);
    link.look(view, width, height);
  }

  destroy() {
    this.link.bitmap?.close();
    this.link.bitmap = null;
  }
}

/** The connection, in the shape of the worker. */
export class ThinLink extends Link {
  constructor() {
    super("", null);
    /** @type {((event: { data: FromWorker }) => void) | null} */
    this.onmessage = null;
    /** @type {ImageBitmap | null} */
    this.bitmap = null;
    this.viewTimer = 0;
    this.view = this.toldView = ""; // as messages
    this.toldAt = -Infinity;
    /** @type {import("./messages.js").Position | null} at which to pause */
    this.stopAt = null;
    /** @type {number | null} */
    this.held = null;
    this.heldUntil = 0;
    /** @type {Map<number, "pick" | "depth">} */
    this.asked = new Map();
  }

  /** @param {FromWorker} data */
  #tell(data) {
    this.onmessage?.({ data });
  }

  tell() {
    this.#tell({
      type: "status",
      status: { ...this.session.status, stopping: this.stopAt !== null },
      refusals: 0,
      now: performance.now(),
    });
  }

  /** @param {import("./messages.js").ToWorker} message */
  postMessage(message) {
    switch (message.type) {
      case "connect":
        this.url = message.live ?? "";
        if (message.token) this.protocols.push(`bearer.${message.token}`);
        this.#wish(message.wishes);
        this.open();
        this.tell();
        break;
      case "wishes":
        this.#wish(message.wishes);
        this.transmit([{ type: "set", ...message.wishes }]);
        break;
      case "send":
        for (const wanted of message.messages) this.#command(wanted);
        break;
      case "hurry":
        this.hurry();
        break;
      case "pick":
      case "depth":
        this.asked.set(message.id, message.type);
        this.transmit([{ ...message, type: "pick" }]);
        break;
      case "inspect":
        this.#tell({ type: "inspected", id: message.id, state: null });
        break;
      case "close":
        this.close();
    }
  }

  /** @param {import("./messages.js").Wishes} wishes */
  #wish(wishes) {
    this.session.wishes = /** @type {any} */ ({ ...wishes, pictures: true });
  }

  /** @param {object[]} messages */
  opened(messages) {
    const { mode, position } = this.session.status;
    this.transmit(messages);
    if (mode === "paused" && position) this.transmit([{ type: "seek", to: position, stop: true }]);
    this.toldView = "";
    this.#sendView();
  }

  /** @param {number} code @param {string} reason */
  closed(code, reason) {
    for (const id of this.asked.keys()) this.#tell({ type: "picked", id, point: null });
    this.asked.clear();
    super.closed(code, reason);
  }

  /** @param {string | ArrayBuffer} data @param {WebSocket} socket */
  hear(data, socket) {
    if (typeof data === "string") this.#hear(data);
    else this.#show(data, socket);
  }

  /** @param {string} text */
  #hear(text) {
    const message = heard(text),
      name = message && nameOf(message);
    if (name === "scene") {
      const cameras = message.cameras.map((/** @type {any} */ { world_to_camera: worldToCamera, ...camera }) => ({
        ...camera,
        worldToCamera,
      }));
      const { background, fps, levels, view_dependent: viewDependent } = message;
      this.#tell({ type: "scene", cameras, background, fps, levels, viewDependent });
    } else if (name === "picked") {
      const kind = this.asked.get(message.id);
      this.asked.delete(message.id);
      this.#tell({ type: "picked", id: message.id, point: kind === "depth" ? [0, 0, message.depth] : message.point });
    } else {
      const told = this.session.control(text, performance.now(), Date.now());
      if (this.session.verdict) this.close();
      if (told?.mode === "paused") this.stopAt = null;
      if (told?.clamped && this.stopAt) this.stopAt = { ...this.stopAt, version: told.version };
      // Where a replay begins is held already, unless it was clamped.
      if (told && told.mode !== "replay") this.#hold(null);
      else if (told?.clamped) this.#hold(told.version);
      this.tell();
    }
  }

  /** Show no other version for a while. @param {number | null} version */
  #hold(version) {
    this.held = version;
    this.heldUntil = performance.now() + HOLD_MS;
  }

  /** A picture came. @param {ArrayBuffer} data @param {WebSocket} socket */
  async #show(data, socket) {
    const { session } = this,
      size = Math.min(HEADER_BYTES, data.byteLength),
      image = new Uint8Array(data, size);
    const start = performance.now(),
      bitmap = await createImageBitmap(new Blob([image], { type: "image/jpeg" })).catch(() => null);
    if (socket !== this.socket) return bitmap?.close();
    if (!bitmap) return this.#refuse();
    const head = new DataView(data, 0, HEADER_BYTES);
    const [number, epoch, version] = [0, 4, 8].map((at) => head.getUint32(at, true));
    session.arrived(
      data.byteLength,
      version === session.status.position?.version ? session.lastPacket : performance.now(),
    );
    const { held } = this; // after a seek the server draws nothing before that version
    if (held === null || held === version || start > this.heldUntil) {
      this.held = null;
      this.bitmap?.close();
      this.bitmap = bitmap;
      session.epoch = epoch;
      session.applied(version, 0, start);
      session.unacknowledged = 0;
      // The server goes on only after the acknowledgement, so it stops where we are.
      if (this.stopAt && session.status.mode === "live" && version >= this.stopAt.version)
        this.#command({ type: "pause" });
      const drawn = { width: head.getUint16(12, true), height: head.getUint16(14, true), quality: head.getUint8(16) };
      this.#tell({
        type: "picture",
        generation: 0,
        rows: 0,
        spans: [],
        order: null,
        splats: 0,
        missing: 0,
        version,
        drawn,
        position: session.status.position,
        decodeMs: performance.now() - start,
        expandMs: head.getUint32(20, true) / 1000,
        sortMs: 0,
      });
    } else bitmap.close();
    this.transmit([{ type: "ack", picture: number }]);
    this.tell();
  }

  /** What came is no picture: leave and come again. */
  #refuse() {
    const { socket, session } = this;
    session.refused++;
    this.socket = null;
    socket?.close(4400, "a picture was refused");
    this.closed(4400, "a picture of the server cannot be read");
  }

  /** @param {any} wanted */
  #command(wanted) {
    const { position, window: range } = this.session.status;
    const message =
      wanted.type === "play" && position
        ? { type: "seek", to: this.stopAt ?? position }
        : wanted.type === "speed"
          ? { type: "set", speed: wanted.value }
          : wanted;
    if (message.type === "seek") {
      this.stopAt = message.stop ? message.to : null;
      this.#hold(message.to === "live" ? (range?.newest.version ?? null) : message.to.version);
    } else if (message.type === "pause") this.stopAt = null;
    this.transmit([message]);
  }

  /**
   * The page drew `view` on a canvas of that size: tell the server, if that is news.
   * @param {View} view
   * @param {number} width
   * @param {number} height
   */
  look({ rotation, translation: t, focal, principal }, width, height) {
    const r = Array.from(rotation);
    this.view = JSON.stringify({ type: "view", width, height, rotation: r, position: centre(r, t), focal, principal });
    this.#sendView();
  }

  #sendView() {
    if (!this.view || this.view === this.toldView || this.viewTimer) return;
    const wait = this.toldAt + VIEW_MS - performance.now();
    if (wait > 0) {
      this.viewTimer = window.setTimeout(() => {
        this.viewTimer = 0;
        this.#sendView();
      }, wait);
    } else if (this.socket?.readyState === WebSocket.OPEN) {
      this.socket.send(this.view);
      this.toldView = this.view;
      this.toldAt = performance.now();
    }
  }

  close() {
    clearTimeout(this.viewTimer);
    super.close();
  }
}
