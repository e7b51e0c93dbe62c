/**
 * Watching together: one viewer presents where it looks and at what moment, others follow until they drag
 * (docs/protocol.md, "Together").
 */

import { cross, dot, row } from "../lib/vectors.js";
import { button, element, toast } from "./page.js";

const SEND_MS = 150;
const APART_SECONDS = 2; // that a replay may be away from the presenter's

/** @typedef {import("../stream/session.js").Together} Known */

export class Together {
  /** @param {import("../view/viewer.js").Viewer} viewer @param {import("./timeline.js").Timeline} timeline */
  constructor(viewer, timeline) {
    this.viewer = viewer;
    this.timeline = timeline;
    /** @type {"apart" | "presenting" | "following"} */
    this.role = "apart";
    /** @type {Known | null} as the server says */
    this.known = null;
    this.sent = ""; // what was presented last
    this.led = ""; // what was followed last
    this.session = "";
    this.timer = 0;
    button("b-together").onclick = () => this.toggle();
    viewer.stance.addEventListener(
      "steered",
      () => this.role === "following" && this.#leave("You look around by yourself again"),
    );
    viewer.addEventListener("status", () => this.#heard(viewer.status?.together ?? null));
  }

  /** Present, follow or stop, whichever the button says. */
  toggle() {
    const { known } = this;
    if (!known || !this.#offered) return;
    if (this.role !== "apart") return this.#leave("");
    if (known.by) {
      this.role = "following";
      this.led = "";
      this.#send({ type: "follow", on: true });
    } else {
      this.role = "presenting";
      this.timer = window.setInterval(() => this.#present(), SEND_MS);
      this.#present();
    }
    this.#show();
  }

  get #offered() {
    const { known, role } = this;
    return known !== null && !this.timeline.recording && (role !== "apart" || known.by !== null || known.mayPresent);
  }

  /** @param {string} why */
  #leave(why) {
    this.#send(this.role === "presenting" ? { type: "present", view: null } : { type: "follow", on: false });
    clearInterval(this.timer);
    this.role = "apart";
    this.sent = "";
    if (why) toast(why);
    this.#show();
  }

  /** @param {object} message */
  #send(message) {
    this.viewer.tell({ type: "send", messages: [message] });
  }

  #present() {
    if (!this.known?.mayPresent) return; // an edge that has lost its origin
    const { stance, status } = this.viewer,
      { position, rotation, distance, focal, stretch, shift } = stance.pose,
      place = status?.position;
    const at = status?.mode === "live" || !place ? { mode: "live" } : { mode: status.mode, ...place };
    // Who follows replays by itself, and needs to know now and then where.
    const moment =
      at.mode === "replay" && place
        ? [place.epoch, Math.floor(place.version / (APART_SECONDS * (status?.fps || 30)))]
        : at;
    const text = JSON.stringify([position, rotation, distance, focal, stretch, shift, moment]);
    if (text === this.sent) return;
    this.sent = text;
    this.#send({ type: "present", view: { position, rotation, distance, focal, stretch, shift }, at });
  }

  /** @param {Known | null} known */
  #heard(known) {
    const before = this.known;
    this.known = known;
    if (known && known.session !== this.session) {
      // another connection: say again what is wanted
      this.session = known.session;
      if (this.role === "following") this.#send({ type: "follow", on: true });
      this.sent = "";
    } else if (known && this.role === "presenting" && known.by !== null && known.by !== known.session)
      this.#leave("Somebody else presents already");
    else if (known && this.role === "following" && before?.by && !known.by) this.#leave("The presenter has left");
    if (known && this.role === "presenting" && known.by === null) this.sent = ""; // the server has forgotten
    if (known && this.role === "following" && known.view) this.#follow(known);
    this.#show();
  }

  /** Look and be where the presenter does. @param {Known} known */
  #follow({ view, at }) {
    const { viewer } = this,
      { status, stance } = viewer,
      text = JSON.stringify([view, at]);
    if (!view || !at || text === this.led) return;
    this.led = text;
    if (isRotation(view.rotation)) stance.moveTo({ ...stance.pose, ...view });
    const here = status?.position,
      there = "epoch" in at ? { epoch: at.epoch, version: at.version } : null;
    if (!there) {
      if (status?.mode !== "live") this.#send({ type: "seek", to: "live" });
      return;
    }
    const apart = here?.epoch === there.epoch ? Math.abs(here.version - there.version) / (status?.fps || 30) : Infinity;
    if (
      at.mode === "paused" ? apart > 0 || status?.mode !== "paused" : status?.mode !== "replay" || apart > APART_SECONDS
    ) {
      this.#send({ type: "seek", to: there, stop: at.mode === "paused" });
    }
  }

  #show() {
    const { role, known } = this,
      control = button("b-together"),
      chip = element("status-together");
    const title = {
      presenting: "Stop presenting",
      following: "Follow no more",
      apart: known?.by ? "Follow the presenter" : "Present my view",
    }[role];
    control.hidden = !this.#offered;
    control.title = `${title} (G)`;
    control.setAttribute("aria-label", title);
    control.setAttribute("aria-pressed", String(role !== "apart"));
    const text = {
      presenting: "You present",
      following: "Following, drag to leave",
      apart: known?.by ? "Somebody presents" : "",
    }[role];
    if (chip.textContent !== text) chip.textContent = text;
  }
}

/** @type {(rotation: number[]) => boolean} */
const isRotation = (rotation) => Math.abs(dot(cross(row(rotation, 0), row(rotation, 1)), row(rotation, 2)) - 1) < 1e-2;
