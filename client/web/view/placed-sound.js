/** Sound that comes from where its microphone stands, heard by ears that are where the page's camera is. */

import { centreOf } from "../lib/rig.js";
import { row } from "../lib/vectors.js";
import { target } from "./camera.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */

const ROLLOFF = 0.5; // twice as far away as the scene's middle is from the microphone, two thirds of the amplitude are left
const MIN_REACH = 1e-6;

/**
 * Where the camera of that name stands, if it is one of the rig.
 * @type {(cameras: import("./camera.js").RigCamera[], name?: string | null) => Vec3 | null}
 */
export function microphoneAt(cameras, name) {
  const camera = cameras.find((each) => each.name === name);
  return camera ? centreOf(camera) : null;
}

/**
 * How far from the microphone sound is as loud as it was recorded: as far as the scene's middle is.
 * @type {(microphone: Vec3, middle: Vec3) => number}
 */
export const reachOf = (microphone, middle) =>
  Math.max(MIN_REACH, Math.hypot(...microphone.map((x, i) => x - middle[i])));

/**
 * Where a head looks, and what is above it, as audio listeners have it.
 * @type {(rotation: number[]) => { ahead: Vec3, up: Vec3 }}
 */
export function facing(rotation) {
  const [x, y, z] = row(rotation, 1);
  return { ahead: row(rotation, 2), up: [-x, -y, -z] };
}

export class PlacedSound {
  /**
   * @param {import("./viewer.js").Viewer} viewer
   * @param {HTMLAudioElement} audio - from now on heard through this alone
   * @param {AbortSignal} signal - ends it
   */
  constructor(viewer, audio, signal) {
    this.viewer = viewer;
    this.context = new AudioContext();
    this.panner = new PannerNode(this.context, {
      panningModel: "HRTF",
      distanceModel: "inverse",
      rolloffFactor: ROLLOFF,
    });
    this.context.createMediaElementSource(audio).connect(this.panner).connect(this.context.destination);
    viewer.addEventListener("looked", (event) => this.#listen(/** @type {CustomEvent} */ (event).detail), { signal });
    signal.addEventListener("abort", () => this.context.close());
    this.#listen(viewer.stance.pose);
  }

  /** How long sound is under way from the audio element to the ear, ms, as far as the browser says. */
  get lateMs() {
    return 1000 * (this.context.baseLatency + (this.context.outputLatency || 0));
  }

  /** The microphone stands there. @param {Vec3} microphone */
  stand(microphone) {
    const {
        panner,
        viewer: { stance },
      } = this,
      [x, y, z] = microphone;
    panner.positionX.value = x;
    panner.positionY.value = y;
    panner.positionZ.value = z;
    panner.refDistance = reachOf(microphone, stance.space?.middle ?? target(stance.pose));
  }

  /** Play, where the browser has stopped it or waited for a gesture. */
  wake() {
    if (this.context.state !== "running") this.context.resume().catch(() => undefined);
  }

  /** Nothing is played for now. */
  rest() {
    if (this.context.state === "running") this.context.suspend();
  }

  /** @param {{ position: Vec3, rotation: number[] }} view */
  #listen({ position, rotation }) {
    const { ahead, up } = facing(rotation),
      { listener } = this.context;
    listener.setPosition(...position); // in all browsers; Firefox has no parameters for it
    listener.setOrientation(...ahead, ...up);
  }
}
