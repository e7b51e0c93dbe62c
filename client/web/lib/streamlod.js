/**
 * streamlod for other programs: a `.slod` file over HTTP Range requests, or a live stream, as Gaussians in typed arrays.
 *
 *     import { open } from "./lib/streamlod.js";
 *     const clip = await open("/files/clip.slod");
 *     const frame = await clip.frame(1.5);
 *
 * docs/library.md says more. Needs a browser of today, or node 20 (22 for live streams).
 */

import { moments, plan } from "../decode/container.js";
import { loadKernel } from "../decode/expand.js";
import { must } from "../decode/packet.js";
import { Connection } from "../stream/connection.js";
import { FileReader } from "../stream/file.js";
import { Columns } from "./frame.js";
import { Gaussians } from "./gaussians.js";
import { centreOf } from "./rig.js";
import { add } from "./vectors.js";

export { follow } from "./follow.js";
export { decompose } from "./frame.js";
export { upright, viewOf } from "./rig.js";

/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {import("./vectors.js").Vec3} Vec3 */
/** @typedef {import("../decode/scene.js").RigCamera} RigCamera */
/**
 * `middle`: of all anchors of the last keyframe, world units.
 * @typedef {{ fps: number, cameras: RigCamera[], background: number[], levels: number, isViewDependent: boolean, middle: Vec3 }} Scene
 */

/**
 * @typedef {object} Options
 * @property {string | null} [token] - where the server asks for one
 * @property {BufferSource} [kernel] - the bytes of decode/kernel.wasm, where they cannot be fetched from beside this module
 */

/** The bytes of the kernel beside this module. @returns {Promise<BufferSource>} */
async function fetchKernel() {
  const place = new URL("../decode/kernel.wasm", import.meta.url);
  if (place.protocol === "file:") {
    const files = "node:fs/promises"; // only under node
    return (await import(files)).readFile(place);
  }
  const answer = await fetch(place);
  if (!answer.ok) throw new Error("kernel.wasm is missing beside the module");
  return answer.arrayBuffer();
}

/** @param {Gaussians} gaussians @returns {Scene} */
function sceneOf({ scene, centre }) {
  if (!scene) throw new Error("there is no keyframe yet");
  const { fps, cameras, background, levels, viewDependent } = scene.header;
  return { fps, cameras, background: [...background], levels, isViewDependent: viewDependent, middle: centre };
}

/**
 * The middle of the rig, from which view-dependent colours are right if nobody says otherwise.
 * @param {Gaussians} gaussians
 * @returns {Vec3}
 */
function middleOf({ scene }) {
  const cameras = scene?.header.cameras ?? [];
  return cameras.reduce(
    (sum, camera) => add(sum, centreOf(camera), 1 / cameras.length),
    /** @type {Vec3} */ ([0, 0, 0]),
  );
}

/**
 * Open a file, or a live stream: an address of `ws:` or `wss:`, or one that ends in `/live`.
 * @param {string} url
 * @param {Options} [options]
 * @returns {Promise<Clip | Live>} once the file's index is read, or the stream has its first frame
 */
export async function open(url, options = {}) {
  const kernel = await loadKernel(options.kernel ?? (await fetchKernel())),
    address = new URL(url, globalThis.location?.href);
  const isLive = /^wss?:$/.test(address.protocol) || /\/live$/.test(address.pathname);
  if (!isLive) {
    const clip = new Clip(new FileReader(address.href, options.token ?? null), kernel);
    await clip.begin();
    return clip;
  }
  address.protocol = address.protocol.replace("http", "ws");
  const live = new Live(address.href, options.token ?? null, kernel);
  await live.begun;
  return live;
}

/** A recording. */
export class Clip {
  /** @param {FileReader} reader @param {import("../decode/expand.js").Kernel} kernel */
  constructor(reader, kernel) {
    this.reader = reader;
    this.gaussians = new Gaussians(kernel);
    this.columns = new Columns();
    /** @type {import("../decode/container.js").Entry[]} */
    this.entries = [];
    /** @type {{ version: number, timeMs: number }[]} */
    this.moments = [];
    /** @type {{ keyframe: number, version: number } | null} what is decoded */
    this.held = null;
    /** @type {Promise<unknown>} frames are read one after the other */
    this.turn = Promise.resolve();
  }

  /** Read the index. */
  async begin() {
    this.entries = await this.reader.entries();
    this.moments = moments(this.entries);
    must(this.moments.length, "bad_file", "the recording is empty or not a .slod file");
    await this.frame(0);
  }

  /** @returns {Scene} */
  get scene() {
    return sceneOf(this.gaussians);
  }

  /** From the first frame to the last, seconds. */
  get duration() {
    return (this.moments[this.moments.length - 1].timeMs - this.moments[0].timeMs) / 1000;
  }

  /** Times of the frames, seconds since the first. */
  get times() {
    return Float64Array.from(this.moments, ({ timeMs }) => (timeMs - this.moments[0].timeMs) / 1000);
  }

  /**
   * The newest frame at a time.
   * @param {number} seconds - since the first frame; outside of the recording, its first or last one
   * @param {{ from?: Vec3, levels?: number }} [view] - from where colours are right; how many levels, coarse ones first
   * @returns {Promise<Frame>}
   */
  frame(seconds, view = {}) {
    const asked = this.turn.then(() => this.#read(seconds, view));
    this.turn = asked.catch(() => {});
    return asked;
  }

  /** @param {number} seconds @param {{ from?: Vec3, levels?: number }} view @returns {Promise<Frame>} */
  async #read(seconds, { from, levels = Infinity }) {
    if (!Number.isFinite(seconds)) throw new TypeError("frame takes a number of seconds");
    const { moments: all, entries, reader, gaussians } = this,
      begin = all[0].timeMs,
      at = begin + 1000 * seconds + 1e-3;
    const moment = all.reduce((last, next) => (next.timeMs <= at ? next : last), all[0]);
    const wanted = plan(entries, moment.version, this.held);
    for (let i = 0, j; i < wanted.length; i = j) {
      // runs of packets that lie side by side are one request
      const first = entries[wanted[i]];
      let { offset: end } = first;
      for (j = i; j < wanted.length && (j === i || entries[wanted[j]].offset === end + 4); j++)
        end = entries[wanted[j]].offset + entries[wanted[j]].size;
      const bytes = await reader.read(first.offset, end);
      for (const number of wanted.slice(i, j)) {
        const { offset, size, keyframe, toVersion: version } = entries[number];
        gaussians.push(bytes.slice(offset - first.offset, offset - first.offset + size));
        this.held = { keyframe, version };
      }
    }
    gaussians.update(from ?? middleOf(gaussians), levels);
    return {
      seconds: (moment.timeMs - begin) / 1000,
      filmedMs: moment.timeMs,
      version: moment.version,
      ...this.columns.take(gaussians),
    };
  }

  close() {
    this.entries = [];
  }
}

/** A stream that goes on. Fires `frame` (detail: a Frame) for each that is shown, and `status` (detail: `status` below). */
export class Live extends EventTarget {
  /** @param {string} url @param {string | null} token @param {import("../decode/expand.js").Kernel} kernel */
  constructor(url, token, kernel) {
    super();
    this.gaussians = new Gaussians(kernel);
    this.columns = new Columns();
    /** @type {Vec3 | null} from where colours are right; null: the middle of the rig */
    this.from = null;
    /** @type {Frame | null} */
    this.newest = null;
    this.begin = NaN; // capture time of the first frame, ms
    /** @type {number | null} version to reach before the next frame */
    this.held = null;
    /** @type {(value?: unknown) => void} */
    let start = () => {};
    /** @type {(error: Error) => void} */
    let refuse = () => {};
    this.begun = new Promise((resolve, reject) => ([start, refuse] = [resolve, reject]));
    this.connection = new Connection(url, token, {
      packet: async (bytes) => this.#take(bytes, start),
      hold: (version) => (this.held = version),
      status: () => {
        const { verdict, status } = this.connection?.session ?? {};
        if (verdict) refuse(new Error(status?.detail || `the stream cannot be watched: ${verdict}`));
        this.dispatchEvent(new CustomEvent("status", { detail: status }));
      },
    });
  }

  /** What is going on: `phase`, `window`, `position`, `lagSeconds` and more (stream/session.js). */
  get status() {
    return this.connection.session.status;
  }

  /** @returns {Scene} */
  get scene() {
    return sceneOf(this.gaussians);
  }

  /** The newest frame. @returns {Promise<Frame>} */
  async frame() {
    await this.begun;
    return /** @type {Frame} */ (this.newest);
  }

  /** Go to a version of an epoch, or to "live". @param {"live" | { epoch: number, version: number }} to */
  seek(to) {
    this.connection.send([{ type: "seek", to }]);
  }

  pause() {
    this.connection.send([{ type: "pause" }]);
  }

  play() {
    this.connection.send([{ type: "play" }]);
  }

  /** @param {Uint8Array} bytes @param {() => void} start */
  #take(bytes, start) {
    const begin = performance.now();
    let effect;
    try {
      effect = this.gaussians.push(bytes);
    } catch {
      return null; // refused: the connection is opened again
    }
    const { timeMs, toVersion } = effect.packet,
      ms = performance.now() - begin;
    if (this.held !== null && toVersion >= this.held) this.held = null;
    if (this.held === null) {
      this.begin = Number.isNaN(this.begin) ? timeMs : this.begin;
      this.gaussians.update(this.from ?? middleOf(this.gaussians), Infinity);
      this.newest = {
        seconds: (timeMs - this.begin) / 1000,
        filmedMs: timeMs,
        version: toVersion,
        ...this.columns.take(this.gaussians),
      };
      this.dispatchEvent(new CustomEvent("frame", { detail: this.newest }));
      start();
    }
    return { version: toVersion, ms, filmedMs: timeMs };
  }

  close() {
    this.connection.close();
  }
}
