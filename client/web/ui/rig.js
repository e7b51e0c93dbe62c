/** The rig in the picture: each camera's name where it stands; a click goes there. */

import { fromCamera } from "../view/camera.js";
import { frusta } from "../view/frusta.js";
import { element } from "./page.js";

/** @typedef {import("../view/viewer.js").Viewer} Viewer */

const DEPTH = 0.12; // of the distance to the target, how far the drawn pyramids reach

export class Rig {
  /** @param {Viewer} viewer @param {(index: number) => void} goTo */
  constructor(viewer, goTo) {
    this.viewer = viewer;
    this.goTo = goTo;
    this.shown = false;
    /** @type {{ name: HTMLButtonElement, position: number[] }[]} */
    this.names = [];
    viewer.addEventListener("frame", () => this.shown && this.#place());
    viewer.addEventListener("scene", () => this.shown && this.draw());
  }

  toggle() {
    this.shown = !this.shown;
    this.draw();
  }

  draw() {
    const { viewer } = this, cameras = this.shown ? (viewer.scene?.cameras ?? []) : [];
    viewer.renderer.setLines(frusta(cameras, DEPTH * viewer.pose.distance));
    this.names = cameras.map((camera, i) => {
      const name = Object.assign(document.createElement("button"), { textContent: camera.name, onclick: () => this.goTo(i) });
      return { name, position: fromCamera(camera, 1).position };
    });
    element("rig").replaceChildren(...this.names.map(({ name }) => name));
    viewer.dirty = true;
  }

  /** Put the names where the cameras are seen. */
  #place() {
    const { canvas } = this.viewer, { rotation: r, translation: t, focal, principal } = this.viewer.view();
    const scale = canvas.clientWidth / canvas.width;
    for (const { name, position: p } of this.names) {
      const [x, y, z] = [0, 1, 2].map((i) => r[3 * i] * p[0] + r[3 * i + 1] * p[1] + r[3 * i + 2] * p[2] + t[i]);
      const u = scale * ((focal[0] * x) / z + principal[0]), v = scale * ((focal[1] * y) / z + principal[1]);
      name.hidden = z < 0.05 || u < 0 || v < 0 || u > canvas.clientWidth || v > canvas.clientHeight;
      name.style.transform = `translate(calc(${u.toFixed(1)}px - 50%), ${v.toFixed(1)}px)`;
    }
  }
}
