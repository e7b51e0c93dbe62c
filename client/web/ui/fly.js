/** Freeze and fly: time stands still while the camera sweeps across the rig and back; and the opening shot of a visit. */

import { orbit } from "../view/camera.js";
import { turnAt, turns } from "../view/flight.js";
import { toast } from "./page.js";

const FLIGHT_MS = 7000,
  OPENING_MS = 4500;
const OPENING_TURN = 0.5; // of what a flight turns
const HANDS = ["pointerdown", "wheel", "keydown"]; // what ends a flight
const still = matchMedia("(prefers-reduced-motion: reduce)");

export class Flight {
  /** @param {import("../view/viewer.js").Viewer} viewer @param {import("./timeline.js").Timeline} timeline */
  constructor(viewer, timeline) {
    this.viewer = viewer;
    this.timeline = timeline;
    /** @type {(() => void) | null} */
    this.stop = null;
  }

  /** Stop time and sweep; afterwards time goes on as before. A second call ends it. */
  toggle() {
    if (this.stop) return this.stop();
    const { timeline, viewer } = this,
      { mode, position } = timeline.status ?? {},
      stood = timeline.stands;
    if (!viewer.picture) return;
    if (!stood) timeline.pause();
    this.#sweep(FLIGHT_MS, 1, () => {
      if (stood) return;
      if (mode === "live" && !timeline.recording) timeline.live();
      else if (position) timeline.play();
    });
  }

  /** The opening shot of a visit: a small sweep while time goes on. */
  open() {
    if (still.matches || this.stop || this.viewer.stance.posed) return;
    this.#sweep(OPENING_MS, OPENING_TURN, () => toast("Drag to look around"));
  }

  /** @param {number} ms @param {number} share - of the turns @param {() => void} then */
  #sweep(ms, share, then) {
    const { viewer } = this,
      { stance } = viewer,
      { pose, up, aim } = stance,
      range = turns(stance.space, pose, up),
      begin = performance.now();
    const end = () => {
      this.stop = null;
      viewer.removeEventListener("frame", step);
      for (const name of HANDS) window.removeEventListener(name, byHand, true);
      then();
    };
    const step = () => {
      if (stance.aim !== aim) return end(); // somebody went elsewhere
      const t = (performance.now() - begin) / ms;
      stance.drift(orbit(pose, up, share * turnAt(Math.min(t, 1), range), 0));
      if (t >= 1) end();
    };
    const byHand = () => this.stop?.();
    this.stop = end;
    viewer.addEventListener("frame", step);
    // The key or click that began it is still on its way.
    setTimeout(() => this.stop === end && HANDS.forEach((name) => window.addEventListener(name, byHand, true)), 0);
  }
}
