/** Other moments of what is watched, drawn from the same place by a second viewer: small over the timeline. */

import { Viewer } from "../view/viewer.js";
import { element } from "./page.js";
import { clock } from "./states.js";

/** @typedef {{ viewer: Viewer, address: (epoch?: number) => string | null, token: string | null }} Source - address: of a file with all of an epoch, by default the newest one, that can be sought */

const LINGER_MS = 4000; // after the pointer has left; it may come back
const THUMB_PX = 16; // of the slider

class Moments {
  /** @param {Source} source @param {string} file @param {HTMLCanvasElement} canvas - in the page */
  constructor({ viewer, token }, file, canvas) {
    this.viewer = viewer;
    this.file = file;
    this.drawer = new Viewer(canvas);
    this.wanted = 0;
    this.drawer.addEventListener("scene", () => this.seek(this.wanted)); // what is said before the file is there is lost
    this.drawer.tell({ type: "connect", live: null, file: new URL(file, location.href).href, token, wishes: {} });
  }

  /** @param {number} version */
  seek(version) {
    this.wanted = version;
    this.drawer.stance.steer(this.viewer.stance.pose);
    this.drawer.tell({ type: "send", messages: [{ type: "pause" }, { type: "seek", to: { version } }] });
  }

  close() {
    this.drawer.destroy();
    this.drawer.canvas.remove();
  }
}

/** The moment under the pointer. @param {Source} source @param {import("./timeline.js").Timeline} timeline */
export function attachPeek(source, timeline) {
  const place = element("t-peek"),
    { scrub } = timeline;
  /** @type {Moments | null} */
  let moments = null;
  let leaving = 0;
  /** @param {PointerEvent} event */
  const move = ({ pointerType, offsetX }) => {
    const share = Math.min(Math.max((offsetX - THUMB_PX / 2) / (scrub.clientWidth - THUMB_PX), 0), 1);
    const { strip } = timeline,
      position = strip.positionAt(share * strip.seconds),
      file = position && source.address(position.epoch);
    if (pointerType !== "mouse" || !file) return;
    clearTimeout(leaving);
    element("t-peek-time").textContent = clock(strip.filmedBefore(share * strip.seconds));
    place.style.setProperty("--at", String(share));
    place.hidden = false;
    if (moments?.file !== file) {
      moments?.close();
      const canvas = document.createElement("canvas");
      place.prepend(canvas);
      moments = new Moments(source, file, canvas);
    }
    moments.seek(position.version);
  };
  scrub.addEventListener("pointermove", move);
  scrub.addEventListener("pointerleave", () => {
    place.hidden = true;
    clearTimeout(leaving);
    leaving = window.setTimeout(() => (moments = moments?.close() ?? null), LINGER_MS);
  });
  return move;
}
