/**
 * The part of the page that shows a stream, without any controls around it: what its worker says, seen from its stance,
 * is drawn by its painter in the size of the page. Fires `scene`, `picture`, `status`, `refused`, `frame`, `drawn`,
 * `looked` and `graphics` events.
 */

import { exposureAt } from "./exposure.js";
import { dot, row } from "../lib/vectors.js";
import { homeCamera } from "./camera.js";
import { drawWithWebgl } from "./drawing.js";
import { nearRadius } from "./limits.js";
import { Pace } from "./pace.js";
import { Painter } from "./painter.js";
import { Stance } from "./stance.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./messages.js").FromWorker} FromWorker */

const LENS = 0.03; // the largest radius of the lens, in distances of what is looked at
const REST_MS = 400,
  HELD_MS = 1000; // a view that has not changed for so long is drawn in full; while a finger or button is down
const MIN_FILL = 0.6; // of a narrow screen's height: what a camera sees is cut left and right to fill that much
const MAX_PATIENCE_MS = 1500; // where pictures take long
const still = matchMedia("(prefers-reduced-motion: reduce)");

export class Viewer extends EventTarget {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import("./drawing.js").Drawing} [drawing] - what draws it; else WebGL2
   * @throws {Error} without WebGL2, where nothing else draws
   */
  constructor(canvas, { renderer, worker } = drawWithWebgl(canvas)) {
    super();
    this.canvas = canvas; // which hands are on, and of the picture's size
    this.painter = new Painter(canvas, renderer);
    this.pace = new Pace();
    this.stance = new Stance(
      (pose) => this.#depthOf(pose),
      () => still.matches,
    );
    this.worker = worker;
    this.thin = renderer.api === "server";
    // What the worker said before it heard of the end may still arrive: nothing may be drawn with what was freed.
    this.worker.onmessage = (/** @type {{ data: FromWorker }} */ { data }) => this.running && this.#hear(data);
    this.aspect = 1; // width over height of the rig's pictures
    this.whole = false; // show all of that on narrow screens, too
    /** @type {import("./messages.js").SceneFacts | null} */
    this.scene = null;
    /** @type {import("./messages.js").Status | null} */
    this.status = null;
    /** @type {import("./messages.js").PictureMessage | null} */
    this.picture = null;
    /** @type {number | null} how many watch the stream, as far as the server says */
    this.watchers = null;
    /** @type {{ state: object, close: () => void } | null} what plays the sound */
    this.sound = null;
    /** @type {string[]} cameras of the rig whose own pictures the server shows */
    this.pictured = [];
    this.blur = 0; // of what is not as far away as what is looked at; 1: the most
    this.levels = Infinity;
    this.resolution = 1; // fraction of the screen's own, while things move
    this.share = 1; // of the splats that is drawn, while things move
    this.resting = false; // drawn in full, because nothing moves
    this.touched = false; // a finger or button is down: what does not move now will
    /** @type {Map<number, (value: any) => void>} */
    this.answers = new Map();
    this.asked = 0;
    this.dirty = true;
    this.running = true;
    this.runs = 0; // how often it began to run, in whichever window
    this.presenting = false; // a headset draws, the page does not
    this.movedAt = 0; // when the view changed last
    this.stance.addEventListener("changed", () => this.viewChanged());
    this.painter.addEventListener("lost", () => this.dispatchEvent(new Event("graphics")));
    this.painter.addEventListener("replaced", () => {
      this.tell({ type: "texture" });
      this.viewChanged();
    });
    this.ends = new AbortController();
    document.addEventListener("visibilitychange", () => this.pace.skip(), { signal: this.ends.signal }); // a hidden page draws nothing
    this.resizer = new ResizeObserver(() => this.resize());
    this.resizer.observe(canvas);
    this.resize();
    this.runIn(window);
  }

  /** Draw by the clock of this window, which the canvas is in, from now on. @param {Window} pane */
  runIn(pane) {
    const run = ++this.runs,
      loop = () => {
        if (!this.running || run !== this.runs) return;
        pane.requestAnimationFrame(loop);
        this.#frame();
      };
    pane.requestAnimationFrame(loop);
    this.resize();
  }

  /** @param {import("./messages.js").ToWorker} message */
  tell(message) {
    this.worker.postMessage(message);
  }

  /** @param {"pick" | "depth"} type @param {Vec3} origin @param {Vec3} direction @returns {Promise<Vec3 | null>} */
  ask(type, origin, direction) {
    const id = ++this.asked;
    this.tell({ type, id, origin, direction });
    return new Promise((resolve) => this.answers.set(id, resolve));
  }

  /** The decoder's state, to compare. @returns {Promise<import("./messages.js").Inspection | null>} */
  inspect() {
    const id = ++this.asked;
    this.tell({ type: "inspect", id });
    return new Promise((resolve) => this.answers.set(id, resolve));
  }

  /** @param {FromWorker} message */
  #hear(message) {
    switch (message.type) {
      case "picture": {
        this.picture = { ...message, spans: [], order: null };
        this.painter.take(message);
        if (message.order || message.spans.length || message.drawn) this.dirty = true; // else they are seen from elsewhere, which is drawn anyway
        break;
      }
      case "scene":
        this.#meet(message);
        break;
      case "status":
        this.status = message.status;
        if (message.status.mode !== "replay") this.painter.renderer.movesFor = 0; // only true states stand still
        break;
      case "picked":
      case "inspected":
        this.answers.get(message.id)?.(message.type === "picked" ? message.point : message.state);
        this.answers.delete(message.id);
        return;
    }
    this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
  }

  /** @param {import("./messages.js").SceneFacts} scene */
  #meet(scene) {
    this.scene = scene;
    this.painter.renderer.background = scene.background;
    if (!scene.cameras.length) return;
    const { width, height } = scene.cameras[homeCamera(scene.cameras)];
    this.aspect = width / height;
    this.stance.meet(scene.cameras);
  }

  /** How far away what is seen in the middle lies, if anything. @param {import("./camera.js").Pose} pose */
  async #depthOf({ position, rotation }) {
    const answer = await this.ask("depth", position, /** @type {Vec3} */ (rotation.slice(6, 9)));
    return answer?.[2];
  }

  /** Something else is watched from now on. */
  forget() {
    this.scene = this.picture = null;
    this.stance.forget();
    this.painter.forget();
  }

  /** Show that colour behind the scene; null: the scene's own. @param {[number, number, number] | null} colour */
  paint(colour) {
    this.painter.paint(colour);
    this.dirty = true;
  }

  /** Blur what is nearer or farther than what is looked at. @param {number} share - 0: not at all, 1: the most */
  focus(share) {
    this.blur = share;
    this.dirty = this.painter.isOld = true;
  }

  viewChanged() {
    this.dirty = true;
    this.movedAt = performance.now();
    this.lookFrom(this.stance.pose);
  }

  /** Ask for splats as they are seen from there. @param {{ position: Vec3, rotation: number[] }} view */
  lookFrom({ position, rotation }) {
    this.tell({
      type: "view",
      view: { position, rotation, levels: this.levels, unsorted: this.painter.renderer.sorts },
    });
    this.dispatchEvent(new CustomEvent("looked", { detail: { position, rotation } }));
  }

  /** Fit the drawing buffer to the page, with the next frame. */
  resize() {
    const { width, height } = this.#size();
    if (width !== this.canvas.width || height !== this.canvas.height) this.dirty = true;
  }

  /** Of the drawing buffer, pixels. */
  #size() {
    const scale = (this.resting ? 1 : this.resolution) * Math.min(devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    return { width, height: Math.max(1, Math.round(this.canvas.clientHeight * scale)) };
  }

  /**
   * Give the drawing buffer its size.
   * @param {boolean} [waits] - even if the page stands still until what is being drawn is done
   * @returns {boolean} whether it has it
   */
  #fit(waits = false) {
    const { canvas } = this,
      { width, height } = this.#size();
    if (width === canvas.width && height === canvas.height) return true;
    if (this.painter.renderer.waiting && !waits) return false;
    Object.assign(canvas, { width, height });
    return true;
  }

  /** @returns {import("./surface.js").View} */
  view() {
    const { width, height } = this.canvas;
    const { rotation, position, focal, stretch, shift, distance } = this.stance.pose;
    const whole = Math.min(height, width / Math.max(this.aspect, 1)); // all that a camera sees from left to right
    const unit = this.whole ? whole : Math.max(whole, MIN_FILL * height);
    const translation = [0, 1, 2].map((i) => -dot(row(rotation, i), position));
    const scale = focal * unit;
    return {
      rotation,
      translation,
      focal: [scale * stretch, scale],
      principal: [width / 2 + shift[0] * unit, height / 2 + shift[1] * unit],
      share: this.resting ? 1 : this.share,
      range: distance,
      lens: LENS * this.blur * distance,
      near: nearRadius(position, this.scene?.cameras ?? []),
      exposure: exposureAt(position, this.scene?.cameras ?? [], this.scene?.exposures),
    };
  }

  #frame() {
    const { painter, pace } = this,
      now = performance.now();
    if (this.presenting || painter.renderer.waiting > 1) return; // what takes longer than a frame shows by the time until the next
    this.stance.step(now);
    this.dispatchEvent(new CustomEvent("frame", { detail: { now } }));
    const { ms, drew, all } = pace.tick(now);
    if (!this.picture) pace.skip(); // what is drawn of no scene says nothing of its speed
    painter.took(ms);
    if (drew) this.dispatchEvent(new CustomEvent("drawn", { detail: { ms, all } }));
    // A view that rests gets everything, also of a new frame, however long that takes.
    const patience = Math.max(this.touched ? HELD_MS : REST_MS, Math.min(2 * pace.frameMs, MAX_PATIENCE_MS));
    const rested = now - this.movedAt > patience,
      isCut = this.resolution < 1 || this.share < 1;
    if (!this.dirty && (!rested || this.resting || !isCut)) return;
    if (rested !== this.resting) {
      this.resting = rested;
      this.dirty = true;
    }
    if (!this.#fit()) return;
    this.draw();
    this.dirty = painter.renderer.moved < 1;
    pace.draw(now, !rested, rested || !isCut);
  }

  /** Whether the screen is so narrow that a camera's picture is cut, or would be. */
  get isNarrow() {
    const { clientWidth, clientHeight } = this.canvas;
    return clientWidth / Math.max(this.aspect, 1) < MIN_FILL * clientHeight;
  }

  /** @param {boolean} whole - all that a camera sees from left to right */
  showWhole(whole) {
    this.whole = whole;
    this.viewChanged();
  }

  draw() {
    this.painter.draw(this.view(), this.resting);
  }

  /** What is seen, as an image. @returns {Promise<Blob>} */
  capture() {
    this.resting = true; // at full resolution, until the next frame
    this.#fit(true);
    this.draw();
    this.dirty = true;
    return new Promise((resolve, reject) => {
      this.painter.renderer.canvas.toBlob(
        (blob) => (blob ? resolve(blob) : reject(new Error("no picture"))),
        "image/png",
      );
    });
  }

  /** Stop everything. */
  destroy() {
    this.running = false;
    this.ends.abort();
    this.resizer.disconnect();
    this.tell({ type: "close" });
    this.painter.destroy();
  }
}
