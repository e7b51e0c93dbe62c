/**
 * Where one stands in the scene and looks, and the ways to go elsewhere: at once, gliding, or by hand in what the rig
 * has seen.
 */

import { rigUp } from "../lib/rig.js";
import { between, fromCamera, homeCamera, target } from "./camera.js";
import { braked, held, outside, seenSpace } from "./limits.js";

/** @typedef {import("./camera.js").Pose} Pose */
/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./camera.js").RigCamera} RigCamera */

const GLIDE_MS = 450;

/** Fires `changed` when the view is another one, and `steered` when a hand did that. */
export class Stance extends EventTarget {
  /**
   * @param {(pose: Pose) => Promise<number | undefined>} depthOf - how far away what is seen in the middle lies, if anything
   * @param {() => boolean} isStill - whether nothing is to glide
   */
  constructor(depthOf, isStill) {
    super();
    this.depthOf = depthOf;
    this.isStill = isStill;
    /** @type {Pose} */
    this.pose = {
      rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1],
      position: [0, 0, -3],
      distance: 3,
      focal: 1,
      stretch: 1,
      shift: [0, 0],
    };
    /** @type {Vec3} */
    this.up = [0, -1, 0];
    /** @type {Pose | null} */
    this.home = null;
    this.aim = this.pose; // where a camera, a link or R led last
    /** @type {{ from: Pose, to: Pose, start: number } | null} */
    this.glide = null;
    /** @type {import("./limits.js").SeenSpace | null} */
    this.space = null;
    this.posed = false; // someone chose a pose: a new scene does not move the camera
  }

  /** There is a scene, which these cameras film. @param {RigCamera[]} cameras - at least one */
  meet(cameras) {
    this.up = rigUp(cameras);
    const first = !this.home,
      begin = fromCamera(cameras[homeCamera(cameras)], this.pose.distance);
    this.home = begin;
    if (first && !this.posed) this.moveTo(begin, false);
    else this.#change();
    this.#orbitAround(begin).then((distance) => {
      this.home = { ...begin, distance };
      this.space = seenSpace(cameras, target(this.home));
    });
  }

  /** Something else is watched from now on. */
  forget() {
    this.home = this.space = null;
    this.posed = false;
  }

  /** Stand where a camera of the rig does. @param {RigCamera} camera @param {boolean} [glide] - move there smoothly */
  standAt(camera, glide) {
    const pose = fromCamera(camera, this.pose.distance);
    this.posed = true;
    this.moveTo(pose, glide);
    this.#orbitAround(pose);
  }

  /**
   * Go around what `pose` looks at, if nobody has gone elsewhere.
   * @param {Pose} pose
   * @returns {Promise<number>} how far away it lies
   */
  async #orbitAround(pose) {
    const distance = (await this.depthOf(pose)) || pose.distance;
    if (this.glide?.to === pose) this.glide.to = { ...pose, distance };
    else if (this.aim === pose) this.pose = { ...this.pose, distance };
    return distance;
  }

  /** @param {Pose} pose @param {boolean} [glide] - move there smoothly */
  moveTo(pose, glide = true) {
    this.aim = pose;
    if (glide && !this.isStill()) {
      this.glide = { from: this.pose, to: pose, start: performance.now() };
      return;
    }
    this.#go(pose);
  }

  /** Go on gliding, if it does. @param {number} now */
  step(now) {
    if (!this.glide) return;
    const { from, to, start } = this.glide,
      t = Math.min(1, (now - start) / GLIDE_MS);
    this.pose = t < 1 ? between(from, to, t * t * (3 - 2 * t)) : to;
    if (t >= 1) this.glide = null;
    this.#change();
  }

  /** The pose was changed by hand. @param {Pose} pose */
  steer(pose) {
    this.posed = true;
    this.dispatchEvent(new Event("steered"));
    this.drift(this.space ? braked(this.space, this.pose, pose) : pose);
  }

  /** The pose changes by itself. @param {Pose} pose */
  drift(pose) {
    this.#go(this.space ? held(this.space, pose) : pose);
  }

  /** How far the view is outside of what the rig has seen, 0 to 1. */
  get outside() {
    return this.space ? outside(this.space, this.pose.position) : 0;
  }

  /** @param {Pose} pose */
  #go(pose) {
    this.glide = null;
    this.pose = pose;
    this.#change();
  }

  #change() {
    this.dispatchEvent(new Event("changed"));
  }
}
