/** The rig over the picture: cameras as pyramids with names to go to, and what each films. */

import { add, dot, row } from "../lib/vectors.js";
import { fromCamera } from "../view/camera.js";
import { element } from "./page.js";

/** @typedef {import("../view/camera.js").Vec3} Vec3 */

const DEPTH = 0.12; // of the distance to the target, how far the drawn pyramids reach
const PICTURE_MS = 1000; // between two pictures of what a camera films
const NEAR = 0.05; // nothing nearer to the eye is drawn

/**
 * Tip and corners of a camera's pyramid.
 * @type {(camera: import("../view/camera.js").RigCamera, depth: number) => Vec3[]}
 */
function pyramid(camera, depth) {
  const { rotation, position } = fromCamera(camera, 1),
    { width, height, intrinsics: k } = camera;
  const base = add(position, row(rotation, 2), depth);
  return [
    position,
    ...[
      [0, 0],
      [width, 0],
      [width, height],
      [0, height],
    ].map(([u, v]) =>
      add(add(base, row(rotation, 0), (depth * (u - k[2])) / k[0]), row(rotation, 1), (depth * (v - k[5])) / k[4]),
    ),
  ];
}

export class Rig {
  /** @param {import("../view/viewer.js").Viewer} viewer @param {(index: number) => void} goTo */
  constructor(viewer, goTo) {
    this.viewer = viewer;
    this.goTo = goTo;
    this.shown = false;
    /** @type {{ name: HTMLButtonElement, points: Vec3[] }[]} */
    this.cameras = [];
    viewer.addEventListener("frame", () => this.shown && this.#place());
    viewer.addEventListener("scene", () => this.draw());
  }

  toggle() {
    this.shown = !this.shown;
    this.draw();
  }

  draw() {
    const { viewer } = this,
      cameras = this.shown ? (viewer.scene?.cameras ?? []) : [];
    this.cameras = cameras.map((camera, i) => {
      const name = Object.assign(document.createElement("button"), {
        textContent: camera.name,
        onclick: () => this.goTo(i),
      });
      return { name, points: pyramid(camera, DEPTH * viewer.stance.pose.distance) };
    });
    element("rig").replaceChildren(element("rig-lines").parentElement ?? "", ...this.cameras.map(({ name }) => name));
    this.#place();
  }

  /** Put lines and names where the cameras are seen. */
  #place() {
    const { canvas } = this.viewer,
      { rotation: r, translation: t, focal, principal } = this.viewer.view();
    const scale = canvas.clientWidth / canvas.width;
    let lines = "";
    for (const { name, points } of this.cameras) {
      const [tip, ...corners] = points.map((p) => {
        const [x, y, z] = [0, 1, 2].map((i) => dot(row(r, i), p) + t[i]);
        return [scale * ((focal[0] * x) / z + principal[0]), scale * ((focal[1] * y) / z + principal[1]), z].map((x) =>
          Number(x.toFixed(1)),
        );
      });
      const [u, v, z] = tip;
      name.hidden = z < NEAR || u < 0 || v < 0 || u > canvas.clientWidth || v > canvas.clientHeight;
      name.style.transform = `translate(calc(${u}px - 50%), ${v}px)`;
      if ([tip, ...corners].some(([, , far]) => far < NEAR)) continue;
      const [a, b, c, d] = corners;
      for (const path of [
        [a, b, c, d, a, tip, b],
        [c, tip, d],
      ])
        lines += `M${path.map(([x, y]) => `${x} ${y}`)}`;
    }
    element("rig-lines").setAttribute("d", lines);
  }
}

/**
 * What a camera films, beside the view, until it is clicked away, `isWanted` no more or another camera's is asked for.
 * @param {string} name
 * @param {string} address
 * @param {string | null} token
 * @param {() => boolean} isWanted
 */
export async function showSource(name, address, token, isWanted) {
  const place = element("source"),
    image = /** @type {HTMLImageElement} */ (place.querySelector("img"));
  const close = () => {
    place.onclick = null;
    place.hidden = true;
  };
  const isOpen = () => place.onclick === close; // a later call puts its own there
  place.onclick = close;
  while (isOpen() && isWanted()) {
    const answer = document.hidden
      ? null
      : await fetch(address, { headers: token ? { Authorization: `Bearer ${token}` } : {} }).catch(() => null);
    const picture = answer?.ok ? await answer.blob().catch(() => null) : null;
    if (!isOpen() || (answer && !answer.ok)) break;
    if (picture) {
      URL.revokeObjectURL(image.src);
      image.src = URL.createObjectURL(picture);
      element("source-name").textContent = image.alt = name;
      place.hidden = false;
    }
    await new Promise((resolve) => setTimeout(resolve, PICTURE_MS));
  }
  if (isOpen()) close();
}
