/** The chip at the top, the card in the middle, and controls that hide from a hand that rests. */

import { distanceTo } from "../view/camera.js";
import { button, element } from "./page.js";
import { duration } from "./states.js";

const IDLE_MS = 4000;

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
  const { title, text, spinner, fraction, button: label, asks } = said.card;
  card.classList.toggle("still", !spinner);
  element("card-title").textContent = title;
  element("card-text").textContent = text;
  const progress = /** @type {HTMLProgressElement} */ (element("card-progress"));
  progress.hidden = fraction == null;
  progress.value = fraction ?? 0;
  element("card-token").hidden = !asks;
  button("card-button").hidden = !label;
  button("card-button").textContent = label ?? "";
}

const DELAYED = ["live", "stalled", "preview", "reconnecting", "waiting"]; // phases in which a delay is told
const OLD = ["preview", "reconnecting", "waiting"]; // phases whose words may hold another time

/** The time since the picture on the screen was filmed, for live cameras; it grows while nothing new comes. */
export class Delay {
  constructor() {
    /** @type {number | null} of the picture that is shown, in the cameras' Unix time */
    this.filmedMs = null;
    /** @type {import("../stream/session.js").Status | null} */
    this.status = null;
  }

  /** Now, s; null where it cannot be told. */
  get seconds() {
    const { filmedMs, status } = this;
    if (
      filmedMs === null ||
      !status ||
      status.clockMs === null ||
      status.source !== "cameras" ||
      status.mode !== "live" ||
      !DELAYED.includes(status.phase)
    )
      return null;
    return Math.max(0, Date.now() + status.clockMs - filmedMs) / 1000;
  }

  /** A picture is shown. @param {number | null} filmedMs */
  picture(filmedMs) {
    this.filmedMs = filmedMs;
  }

  /**
   * In the chip.
   * @param {import("../stream/session.js").Status | null} status
   * @param {boolean} isLost - nothing is drawn
   */
  show(status, isLost) {
    this.status = status;
    const { seconds } = this,
      old = status && OLD.includes(status.phase) ? " old" : "";
    element("status-latency").textContent = seconds === null || isLost ? "" : duration(seconds) + old;
  }
}

/** The picture in words. @param {import("../view/viewer.js").Viewer} viewer @param {string} time */
export function describe({ scene, stance: { pose } }, time) {
  const nearest = scene?.cameras.reduce(
    (a, b) => (distanceTo(pose.position, b) < distanceTo(pose.position, a) ? b : a),
    scene.cameras[0],
  );
  return `${element("status-text").textContent}, ${time}${nearest ? `, seen from near ${nearest.name}` : ""}`;
}

/**
 * Hide the controls of a picture that plays when nobody has touched anything for a while.
 * @param {() => boolean} plays
 */
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
