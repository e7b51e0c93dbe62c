/** The chip at the top, the card in the middle, and controls that hide from a hand that rests. */

import { distanceTo } from "../view/camera.js";
import { button, element } from "./page.js";

const IDLE_MS = 4000;
const MAX_LATENCY_MS = 600_000; // more is no delay but a clock that is wrong

/** @param {import("./states.js").Words} said */
export function show(said) {
  const stage = element("stage");
  stage.dataset.tone = said.tone;
  const chip = element("status-text");
  if (chip.textContent !== said.chip) chip.textContent = said.chip;
  const card = element("card");
  card.hidden = !said.card;
  stage.toggleAttribute("data-card", said.card !== null);
  if (!said.card) return;
  const { title, text, spinner, fraction, button: label } = said.card;
  card.classList.toggle("still", !spinner);
  element("card-title").textContent = title;
  element("card-text").textContent = text;
  const progress = /** @type {HTMLProgressElement} */ (element("card-progress"));
  progress.hidden = fraction == null;
  progress.value = fraction ?? 0;
  button("card-button").hidden = !label;
  button("card-button").textContent = label ?? "";
}

/** From the moment at which a frame was filmed to that at which it is drawn, for live cameras. */
export class Latency {
  constructor() {
    /** @type {number | null} */
    this.ms = null;
    this.version = -1;
  }

  /** A frame is about to be drawn. @param {import("../view/messages.js").PictureMessage} picture @param {import("../stream/session.js").Status | null} status */
  add({ version, timeMs }, status) {
    const isLive = status?.source === "cameras" && status.phase === "live" && status.clockMs !== null && timeMs !== undefined;
    if (!isLive) this.ms = null;
    if (!isLive || version === this.version) return;
    this.version = version;
    const { clockMs } = /** @type {{ clockMs: number }} */ (status);
    requestAnimationFrame(() => {
      const ms = Date.now() + clockMs - /** @type {number} */ (timeMs);
      if (ms < 0 || ms > MAX_LATENCY_MS) this.ms = null;
      else this.ms = this.ms === null ? ms : this.ms + (ms - this.ms) * 0.2;
    });
  }

  /** In the chip, while it is live. @param {string | undefined} phase */
  show(phase) {
    if (phase !== "live") this.ms = null;
    element("status-latency").textContent = this.ms === null ? "" : `${Math.round(this.ms)} ms`;
  }
}

/** The picture in words. @param {import("../view/viewer.js").Viewer} viewer @param {string} time */
export function describe({ scene, pose }, time) {
  const nearest = scene?.cameras.reduce((a, b) => (distanceTo(pose.position, b) < distanceTo(pose.position, a) ? b : a), scene.cameras[0]);
  return `${element("status-text").textContent}, ${time}${nearest ? `, seen from near ${nearest.name}` : ""}`;
}

/** Hide the controls of a picture that plays when nobody has touched anything for a while. @param {() => boolean} plays */
export function hideWhenIdle(plays) {
  let timer = 0;
  const wake = () => {
    document.body.classList.remove("idle");
    clearTimeout(timer);
    timer = window.setTimeout(() => (plays() ? document.body.classList.add("idle") : wake()), IDLE_MS);
  };
  for (const name of ["pointermove", "pointerdown", "keydown", "focusin"]) window.addEventListener(name, wake);
  wake();
  return wake;
}
