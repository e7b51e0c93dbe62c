/**
 * What draws, one after the other: WebGPU, WebGL2 or the server; and the last picture moved on, where splats take too
 * long.
 */

import { Renderer } from "./renderer.js";
import { Surface } from "./surface.js";
import { Warp } from "./warp.js";

/**
 * Fires `replaced` when another one draws, which has nothing yet, and `lost` when there is a graphics card no more, or
 * again.
 */
export class Painter extends EventTarget {
  /** @param {HTMLCanvasElement} canvas @param {Surface} renderer */
  constructor(canvas, renderer) {
    super();
    this.canvas = canvas; // of the page, which hands are on
    this.renderer = renderer;
    this.isLost = false; // the browser took the graphics card away
    /** @type {[number, number, number] | null} shown behind the scene instead of its own colour */
    this.backdrop = null;
    this.warps = false; // while things move, moves the last picture rather than draws the splats
    /** @type {Warp | null} */
    this.warp = null;
    this.isOld = false; // what it keeps is, as something new came
    this.kept = false; // a picture for it was drawn in the last frame
    this.generation = -1; // of the scene that it holds
    /** @type {number | null} of that scene */
    this.version = null;
    this.running = true;
    renderer.ends?.then(() => this.fallBack());
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // else the browser does not give it back
      this.#lose(true);
    });
    canvas.addEventListener("webglcontextrestored", () => this.#restore());
  }

  /** Take what the worker has sent. @param {import("./messages.js").PictureMessage} picture */
  take({ generation, rows, spans, overMs, order, missing, version }) {
    const { renderer } = this;
    if (generation !== this.generation) renderer.clear();
    this.generation = generation;
    renderer.update(rows, spans, overMs);
    if (order) renderer.setOrder(order);
    renderer.missing = missing;
    this.isOld ||= version !== this.version;
    this.version = version;
    if (this.isLost && !renderer.isLost) this.#lose(false);
  }

  /** Something else is watched from now on. */
  forget() {
    this.generation = -1;
    this.version = null;
  }

  /** Show that colour behind the scene; null: the scene's own. @param {[number, number, number] | null} colour */
  paint(colour) {
    this.backdrop = this.renderer.backdrop = colour;
    this.isOld = true;
  }

  /**
   * @param {import("./surface.js").View} view
   * @param {boolean} rests - draw everything, whatever moves the last picture
   */
  draw(view, rests) {
    const warp = this.#warping();
    if (!warp) return this.renderer.draw(view);
    const { width, height } = this.canvas;
    if (rests || warp.isDue(view, this.isOld)) {
      warp.keep(view, width, height);
      this.kept = true;
      this.isOld = false;
    }
    warp.draw(view);
  }

  /** What was drawn in the last frame took so long. @param {number} ms */
  took(ms) {
    if (this.kept && this.warp) this.warp.costMs = ms;
    this.kept = false;
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

  /** @param {boolean} isLost */
  #lose(isLost) {
    this.isLost = isLost;
    if (this.running) this.dispatchEvent(new Event("lost"));
  }

  #restore() {
    if (!this.running) return;
    this.#drawWith(new Renderer(this.canvas));
    if (this.version === null) this.#lose(false); // else with the next picture, which is on its way
  }

  /** Another one draws from now on, as soon as the worker has sent everything. @param {Surface} renderer */
  #drawWith(renderer) {
    const { background } = this.renderer;
    this.renderer = Object.assign(renderer, { background, backdrop: this.backdrop });
    this.warp = null;
    this.generation = -1;
    this.dispatchEvent(new Event("replaced"));
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

  /** Free everything on the graphics card. */
  destroy() {
    this.running = false;
    this.warp?.destroy();
    this.renderer.destroy();
  }
}
