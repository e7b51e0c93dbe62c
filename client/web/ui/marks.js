/** Moments on the bar to come back to: buttons that can be reached by keyboard, named, moved and taken away. */

import { element } from "./page.js";
import { clock } from "./states.js";

/** @typedef {{ epoch: number | null, version: number }} Moment - epoch null: the newest one */
/** @typedef {{ moment: Moment, button: HTMLButtonElement, name: string }} Mark */

const DRAG_PX = 4; // less is a click

export class Marks {
  /** @param {import("./timeline.js").Timeline} timeline */
  constructor(timeline) {
    this.timeline = timeline;
    /** @type {Mark[]} in the order in which they were made */
    this.list = [];
  }

  /** The moment that was marked last. */
  get newest() {
    return this.list[this.list.length - 1]?.moment;
  }

  /** Mark a moment, or take its mark away. @param {Moment} moment */
  toggle(moment) {
    const old = this.list.find(
      ({ moment: { epoch, version } }) => version === moment.version && (epoch ?? moment.epoch) === moment.epoch,
    );
    if (old) return this.#remove(old);
    const button = document.createElement("button");
    const mark = { moment, button, name: "" };
    this.list.push(mark);
    button.onclick = () => this.timeline.seekTo(this.#position(mark.moment));
    button.onkeydown = (event) => this.#key(event, mark);
    button.onpointerdown = (event) => this.#drag(event, mark);
    button.ondblclick = () => this.#name(mark);
    element("t-marks").append(button);
    this.place();
  }

  /** @param {Moment} moment @returns {import("../stream/session.js").Position | null} */
  #position({ epoch, version }) {
    const newest = this.timeline.window?.newest.epoch;
    return newest === undefined ? null : { epoch: epoch ?? newest, version };
  }

  /** @param {Mark} mark */
  #remove(mark) {
    mark.button.remove();
    this.list.splice(this.list.indexOf(mark), 1);
  }

  /** Ask for a name beside the mark: a window of its own may not open inside other pages. @param {Mark} mark */
  #name(mark) {
    const field = document.createElement("input");
    field.maxLength = 60;
    field.value = mark.name;
    field.setAttribute("aria-label", "Name of this mark");
    field.style.setProperty("--at", mark.button.style.getPropertyValue("--at"));
    field.onkeydown = (event) => {
      if (event.key === "Escape") field.value = mark.name;
      if (event.key === "Enter" || event.key === "Escape") mark.button.focus();
      event.stopPropagation();
    };
    field.onblur = () => {
      mark.name = field.value;
      field.remove();
      this.place();
    };
    element("t-marks").append(field);
    field.focus();
    field.select();
  }

  /** @param {KeyboardEvent} event @param {Mark} mark */
  #key(event, mark) {
    const position = this.#position(mark.moment),
      by = event.key === "ArrowLeft" ? -1 : event.key === "ArrowRight" ? 1 : 0;
    if (event.key === "Delete" || event.key === "Backspace") this.#remove(mark);
    else if (event.key === "F2") this.#name(mark);
    else if (by && position) mark.moment = { ...position, version: Math.max(0, position.version + by) };
    else return;
    event.preventDefault();
    event.stopPropagation();
    this.place();
  }

  /** @param {PointerEvent} event @param {Mark} mark */
  #drag(event, mark) {
    const { button } = mark,
      { scrub, strip } = this.timeline,
      from = event.clientX;
    let moved = false;
    button.setPointerCapture(event.pointerId);
    button.onpointermove = ({ clientX }) => {
      moved ||= Math.abs(clientX - from) > DRAG_PX;
      const box = scrub.getBoundingClientRect(),
        share = Math.min(Math.max((clientX - box.left - 8) / (box.width - 16), 0), 1);
      const position = moved ? strip.positionAt(share * strip.seconds) : null;
      if (position) mark.moment = position;
      this.place();
    };
    button.onpointerup = button.onpointercancel = () => {
      button.onpointermove = null;
      if (moved)
        button.addEventListener("click", (click) => click.stopImmediatePropagation(), { capture: true, once: true });
    };
  }

  /** Put every mark where its moment lies. */
  place() {
    const { strip } = this.timeline;
    for (const { moment, button, name } of this.list) {
      const position = this.#position(moment);
      const part =
        position &&
        strip.parts.find(
          ({ epoch, first, last }) => epoch === position.epoch && first <= position.version && position.version <= last,
        );
      button.hidden = !part;
      if (!part || !position) continue;
      const place = strip.placeOf(position);
      button.title = name ? `${name}, ${clock(place)}` : `Mark at ${clock(place)}`;
      button.setAttribute("aria-label", button.title);
      button.style.setProperty("--at", String(strip.seconds > 0 ? place / strip.seconds : 1));
    }
  }
}
