/**
 * The part of the page that draws: worker, renderer and pose, without any controls around them.
 * Fires `scene`, `picture`, `status`, `refused`, `frame`, `drawn`, `graphics` and `steered` events.
 */

import { exposureAt } from "./exposure.js";
import { rigUp } from "../lib/rig.js";
import { between, dot, fromCamera, homeCamera, row, target } from "./camera.js";
import { drawWithWebgl } from "./drawing.js";
import { braked, held, nearRadius, outside, seenSpace } from "./limits.js";
import { Renderer } from "./renderer.js";
import { Surface } from "./surface.js";
import { Warp } from "./warp.js";

/** @typedef {import("./camera.js").Pose} Pose */
/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./messages.js").FromWorker} FromWorker */

const GLIDE_MS = 450;
const LENS = 0.03; // the largest radius of the lens, in distances of what is looked at
const REST_MS = 400, HELD_MS = 1000; // a view that has not changed for so long is drawn in full; while a finger or button is down
const MIN_FILL = 0.6; // of a narrow screen's height: what a camera sees is cut left and right to fill that much
const MAX_PATIENCE_MS = 1500; // where pictures take long
const VSYNC_MS = 25, ASLEEP_MS = 3000; // between two frames: more means that drawing was waited for; that nobody looked
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
    this.renderer = renderer;
    this.worker = worker;
    this.thin = renderer.api === "server";
    renderer.ends?.then(() => this.fallBack());
    // What the worker said before it heard of the end may still arrive: nothing may be drawn with what was freed.
    this.worker.onmessage = (/** @type {{ data: FromWorker }} */ { data }) => this.running && this.#hear(data);
    /** @type {Pose} */
    this.pose = { rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], position: [0, 0, -3], distance: 3, focal: 1, stretch: 1, shift: [0, 0] };
    /** @type {Vec3} */
    this.up = [0, -1, 0];
    /** @type {Pose | null} */
    this.home = null;
    this.aspect = 1; // width over height of the rig's pictures
    this.whole = false; // show all of that on narrow screens, too
    /** @type {import("./limits.js").SeenSpace | null} */
    this.space = null;
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
    this.isLost = false; // the browser took the graphics card away
    /** @type {[number, number, number] | null} shown behind the scene instead of its own colour */
    this.backdrop = null;
    this.blur = 0; // of what is not as far away as what is looked at; 1: the most
    this.posed = false; // someone chose a pose: a new scene does not move the camera
    this.levels = Infinity;
    this.resolution = 1; // fraction of the screen's own, while things move
    this.share = 1; // of the splats that is drawn, while things move
    this.warps = false; // while things move, moves the last picture rather than draws the splats
    /** @type {Warp | null} */
    this.warp = null;
    this.isOld = false; // what it keeps is, as something new came
    this.kept = false; // a picture for it was drawn in the last frame
    this.resting = false; // drawn in full, because nothing moves
    this.timed = { frames: 0, ms: 0 }; // drawn since `pace` was asked for, and the time that took
    this.lastFrame = -Infinity;
    this.touched = false; // a finger or button is down: what does not move now will
    this.frameMs = 0; // that the newest picture took
    this.drew = this.drewAll = false; // since the last frame: while things move; everything there is
    this.fps = 0;
    this.frames = 0;
    /** @type {{ from: Pose, to: Pose, start: number } | null} */
    this.glide = null;
    this.aim = this.pose; // where a camera, a link or R led last
    /** @type {Map<number, (value: any) => void>} */
    this.answers = new Map();
    this.asked = 0;
    this.generation = -1;
    this.dirty = true;
    this.running = true;
    this.runs = 0; // how often it began to run, in whichever window
    this.presenting = false; // a headset draws, the page does not
    this.lastDraw = 0;
    this.movedAt = 0; // when the view changed last
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // else the browser does not give it back
      this.#lose(true);
    });
    canvas.addEventListener("webglcontextrestored", () => this.#restore());
    this.ends = new AbortController();
    document.addEventListener("visibilitychange", () => (this.lastFrame = -Infinity), { signal: this.ends.signal }); // a hidden page draws nothing
    this.resizer = new ResizeObserver(() => this.resize());
    this.resizer.observe(canvas);
    this.resize();
    this.runIn(window);
  }

  /** Draw by the clock of this window, which the canvas is in, from now on. @param {Window} pane */
  runIn(pane) {
    const run = ++this.runs, loop = () => {
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
        if (message.generation !== this.generation) this.renderer.clear();
        this.generation = message.generation;
        this.renderer.update(message.rows, message.spans, message.overMs);
        if (message.order) this.renderer.setOrder(message.order);
        this.renderer.missing = message.missing;
        this.isOld ||= message.version !== this.picture?.version;
        this.picture = { ...message, spans: [], order: null };
        if (message.order || message.spans.length || message.drawn) this.dirty = true; // else they are seen from elsewhere, which is drawn anyway
        if (this.isLost && !this.renderer.isLost) this.#lose(false);
        break;
      }
      case "scene":
        this.#meet(message);
        break;
      case "status":
        this.status = message.status;
        if (message.status.mode !== "replay") this.renderer.movesFor = 0; // only true states stand still
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
    this.renderer.background = scene.background;
    if (!scene.cameras.length) return;
    this.up = rigUp(scene.cameras);
    const first = !this.home;
    const index = homeCamera(scene.cameras);
    const begin = fromCamera(scene.cameras[index], this.pose.distance);
    this.home = begin;
    this.aspect = scene.cameras[index].width / scene.cameras[index].height;
    if (first && !this.posed) this.moveTo(begin, false);
    else this.viewChanged();
    this.#orbitAround(begin).then((distance) => {
      this.home = { ...begin, distance };
      this.space = seenSpace(scene.cameras, target(this.home));
    });
  }

  /** Something else is watched from now on. */
  forget() {
    this.generation = -1;
    this.scene = this.home = this.space = this.picture = null;
    this.posed = false;
  }

  /** Show that colour behind the scene; null: the scene's own. @param {[number, number, number] | null} colour */
  paint(colour) {
    this.backdrop = this.renderer.backdrop = colour;
    this.dirty = this.isOld = true;
  }

  /** Blur what is nearer or farther than what is looked at. @param {number} share - 0: not at all, 1: the most */
  focus(share) {
    this.blur = share;
    this.dirty = this.isOld = true;
  }

  /** Stand where a camera of the rig does. @param {import("./camera.js").RigCamera} camera @param {boolean} [glide] - move there smoothly */
  standAt(camera, glide) {
    const pose = fromCamera(camera, this.pose.distance);
    this.posed = true;
    this.moveTo(pose, glide);
    this.#orbitAround(pose);
  }

  /** Go around what `pose` looks at, if nobody has gone elsewhere. @param {Pose} pose @returns {Promise<number>} how far away it lies */
  async #orbitAround(pose) {
    const answer = await this.ask("depth", pose.position, /** @type {Vec3} */ (pose.rotation.slice(6, 9)));
    const distance = answer?.[2] || pose.distance;
    if (this.glide?.to === pose) this.glide.to = { ...pose, distance };
    else if (this.aim === pose) this.pose = { ...this.pose, distance };
    return distance;
  }

  /** @param {Pose} pose @param {boolean} [glide] - move there smoothly */
  moveTo(pose, glide = true) {
    this.aim = pose;
    if (glide && !still.matches) {
      this.glide = { from: this.pose, to: pose, start: performance.now() };
      this.dirty = true;
      return;
    }
    this.glide = null;
    this.pose = pose;
    this.viewChanged();
  }

  /** The pose was changed by hand. @param {Pose} pose */
  steer(pose) {
    this.posed = true;
    this.dispatchEvent(new Event("steered"));
    this.drift(this.space ? braked(this.space, this.pose, pose) : pose);
  }

  /** The pose changes by itself. @param {Pose} pose */
  drift(pose) {
    this.glide = null;
    this.pose = this.space ? held(this.space, pose) : pose;
    this.viewChanged();
  }

  /** How far the view is outside of what the rig has seen, 0 to 1. */
  get outside() {
    return this.space ? outside(this.space, this.pose.position) : 0;
  }

  viewChanged() {
    this.dirty = true;
    this.movedAt = performance.now();
    this.lookFrom(this.pose);
  }

  /** Ask for splats as they are seen from there. @param {{ position: Vec3, rotation: number[] }} view */
  lookFrom({ position, rotation }) {
    this.tell({ type: "view", view: { position, rotation, levels: this.levels, unsorted: this.renderer.sorts } });
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

  /** Give the drawing buffer its size. @param {boolean} [waits] - even if the page stands still until what is being drawn is done @returns {boolean} whether it has it */
  #fit(waits = false) {
    const { canvas } = this, { width, height } = this.#size();
    if (width === canvas.width && height === canvas.height) return true;
    if (this.renderer.waiting && !waits) return false;
    Object.assign(canvas, { width, height });
    return true;
  }

  /** @returns {import("./surface.js").View} */
  view() {
    const { width, height } = this.canvas;
    const { rotation, position, focal, stretch, shift } = this.pose;
    const whole = Math.min(height, width / Math.max(this.aspect, 1)); // all that a camera sees from left to right
    const unit = this.whole ? whole : Math.max(whole, MIN_FILL * height);
    const translation = [0, 1, 2].map((i) => -dot(row(rotation, i), position));
    const scale = focal * unit;
    return { rotation, translation, focal: [scale * stretch, scale], principal: [width / 2 + shift[0] * unit, height / 2 + shift[1] * unit],
      share: this.resting ? 1 : this.share, range: this.pose.distance, lens: LENS * this.blur * this.pose.distance,
      near: nearRadius(position, this.scene?.cameras ?? []), exposure: exposureAt(position, this.scene?.cameras ?? [], this.scene?.exposures) };
  }

  #frame() {
    if (this.presenting || this.renderer.waiting > 1) return; // what takes longer than a frame shows by the time until the next
    const now = performance.now();
    if (this.glide) {
      const t = Math.min(1, (now - this.glide.start) / GLIDE_MS);
      const eased = t * t * (3 - 2 * t);
      this.pose = t < 1 ? between(this.glide.from, this.glide.to, eased) : this.glide.to;
      if (t >= 1) this.glide = null;
      this.viewChanged();
    }
    this.dispatchEvent(new CustomEvent("frame", { detail: { now } }));
    this.#clock(now);
    // A view that rests gets everything, also of a new frame, however long that takes.
    const patience = Math.max(this.touched ? HELD_MS : REST_MS, Math.min(2 * this.frameMs, MAX_PATIENCE_MS));
    const rested = now - this.movedAt > patience, isCut = this.resolution < 1 || this.share < 1;
    if (!this.dirty && (!rested || this.resting || !isCut)) return;
    if (rested !== this.resting) {
      this.resting = rested;
      this.dirty = true;
    }
    if (!this.#fit()) return;
    this.drew = !rested;
    this.drewAll = rested || !isCut;
    this.draw();
    this.dirty = this.renderer.moved < 1;
    const elapsed = now - this.lastDraw;
    this.lastDraw = now;
    if (elapsed < 1000) this.fps += (1000 / Math.max(elapsed, 1) - this.fps) * (this.frames++ < 3 ? 1 : 0.1);
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
    const view = this.view(), warp = this.#warping();
    if (!warp) return this.renderer.draw(view);
    const { width, height } = this.canvas;
    if (this.resting || warp.isDue(view, this.isOld)) {
      warp.keep(view, width, height);
      this.kept = true;
      this.isOld = false;
    }
    warp.draw(view);
  }

  /** What moves the last picture, where that is wanted and can be. @returns {Warp | null} */
  #warping() {
    const { renderer } = this;
    if (!this.warps || !(renderer instanceof Renderer)) return null;
    try {
      return (this.warp ??= new Warp(renderer));
    } catch {
      this.warps = false;
      return null;
    }
  }

  /** Time that drawing took: that until the next frame, and that of frames which came late. @param {number} now */
  #clock(now) {
    const ms = now - this.lastFrame;
    this.lastFrame = this.picture ? now : -Infinity; // what is drawn of no scene says nothing of its speed
    if (this.drew && ms < ASLEEP_MS) this.frameMs = ms;
    if (this.kept && this.warp) this.warp.costMs = ms;
    this.kept = false;
    if (ms < ASLEEP_MS && (this.drew || ms > VSYNC_MS)) {
      this.timed.frames += Number(this.drew);
      this.timed.ms += ms;
    }
    if ((this.drew || this.drewAll) && ms < ASLEEP_MS) this.dispatchEvent(new CustomEvent("drawn", { detail: { ms, all: this.drewAll } }));
    this.drewAll = false;
    this.drew = false;
  }

  /** Frames a second that drawing sustained since the last answer; null: too little to tell. */
  pace() {
    const { frames, ms } = this.timed;
    if (frames < 2 || ms < 200) return null;
    this.timed = { frames: 0, ms: 0 };
    return (1000 * frames) / ms;
  }

  /** @param {boolean} isLost */
  #lose(isLost) {
    this.isLost = isLost;
    if (this.running) this.dispatchEvent(new CustomEvent("graphics", { detail: { isLost } }));
  }

  #restore() {
    if (!this.running) return;
    this.#drawWith(new Renderer(this.canvas));
    if (!this.picture) this.#lose(false); // else with the next picture, which is on its way
  }

  /** Another one draws from now on, as soon as the worker has sent everything. @param {Surface} renderer */
  #drawWith(renderer) {
    const { background } = this.renderer;
    this.renderer = Object.assign(renderer, { background, backdrop: this.backdrop });
    this.warp = null;
    this.generation = -1;
    this.tell({ type: "texture" });
    this.viewChanged();
  }

  /** WebGL2 draws from now on: WebGPU cannot any more, or is not what is needed. */
  fallBack() {
    if (!this.running || this.renderer.api !== "WebGPU") return;
    this.renderer.destroy();
    try {
      this.#drawWith(new Renderer(this.canvas));
    } catch {
      this.#drawWith(new Surface(this.canvas));
      this.#lose(true);
    }
  }

  /** Whether it is drawn by the processor. */
  get software() {
    return /swiftshader|llvmpipe|software|basic render/i.test(this.renderer.hardware);
  }

  /** What is seen, as an image. @returns {Promise<Blob>} */
  capture() {
    this.resting = true; // at full resolution, until the next frame
    this.#fit(true);
    this.draw();
    this.dirty = true;
    return new Promise((resolve, reject) => {
      this.renderer.canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("no picture"))), "image/png");
    });
  }

  /** Stop everything. */
  destroy() {
    this.running = false;
    this.ends.abort();
    this.resizer.disconnect();
    this.tell({ type: "close" });
    this.warp?.destroy();
    this.renderer.destroy();
  }
}
