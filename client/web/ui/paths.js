/** The panel of viewpoints and camera paths: named, edited, played, filmed; the address keeps them. */

import { fromText, toText } from "../view/camera.js";
import { checked, EMPTY, fromLink, lengthOf, MAX_KEYS, poseAt, toJson, toLink } from "../view/path.js";
import { attachMenu, button, element, keepInAddress, menuItem, toast } from "./page.js";
import { download } from "./sharing.js";

/** @typedef {import("../view/path.js").Path} Path */

const STEP_SECONDS = 3; // from the last viewpoint to a new one
const FPS = 30;
const SIZES = ["1280x720", "1920x1080", "3840x2160"];

export class Paths {
  /** @param {import("../view/viewer.js").Viewer} viewer @param {import("./timeline.js").Timeline} timeline */
  constructor(viewer, timeline) {
    this.viewer = viewer;
    this.timeline = timeline;
    this.path = EMPTY;
    /** @type {(() => void) | null} ends what plays */
    this.stop = null;
    /** @type {AbortController | null} of the film that is made */
    this.filming = null;
    this.size = SIZES[0];
    this.panel = element("path-menu");
    const text = new URLSearchParams(location.search).get("path");
    try {
      if (text) this.path = fromLink(text);
    } catch (error) {
      toast(/** @type {Error} */ (error).message);
    }
    attachMenu(button("b-path"), this.panel, () => this.#fill());
  }

  /** A file that was dropped. @param {string} text */
  open(text) {
    try {
      this.#change(checked(JSON.parse(text)));
      toast(`${this.path.name || "A path"} with ${this.path.keys.length} viewpoints`);
    } catch (error) {
      toast(`This is no camera path: ${/** @type {Error} */ (error).message}`);
    }
  }

  /**
   * @param {Path} path
   * @param {boolean} [isDrawn] - the panel shows it already, as whoever edits a field goes on to the next
   */
  #change(path, isDrawn = false) {
    this.path = path;
    keepInAddress("path", path.keys.length ? toLink(path) : null);
    if (!this.panel.hidden && !isDrawn) this.#fill();
  }

  /** @param {Partial<Path>} changes */
  #set(changes) {
    this.#change({ ...this.path, ...changes });
  }

  /**
   * Change a viewpoint, from a field that shows that already.
   * @param {number} i
   * @param {Partial<import("../view/path.js").Key>} changes
   */
  #edit(i, changes) {
    const edited = this.path.keys.map((key, j) => (j === i ? { ...key, ...changes } : key)),
      keys = [...edited].sort((a, b) => a.seconds - b.seconds);
    try {
      this.#change(
        checked({ version: 1, ...this.path, keys }),
        keys.every((key, j) => key === edited[j]),
      );
    } catch {
      toast("Two viewpoints cannot have the same time");
      this.#fill();
    }
  }

  /** Add the view that is seen. */
  add() {
    const { keys } = this.path,
      seconds = keys.length ? lengthOf(this.path) + STEP_SECONDS : 0;
    if (keys.length >= MAX_KEYS) return toast(`A path has at most ${MAX_KEYS} viewpoints`);
    this.#set({
      keys: [...keys, { seconds, camera: toText(this.viewer.stance.pose), name: `View ${keys.length + 1}` }],
    });
  }

  /** Move along the path, or stop. */
  toggle() {
    if (this.stop) return this.stop();
    const { viewer, path } = this,
      begin = performance.now();
    if (path.keys.length < 2) return toast("A path needs two viewpoints");
    const step = () => {
      const t = (performance.now() - begin) / 1000,
        pose = poseAt(path, t);
      viewer.stance.posed = true;
      if (pose) viewer.stance.drift(pose);
      if (!path.loops && t >= lengthOf(path)) this.stop?.();
    };
    this.stop = () => {
      this.stop = null;
      viewer.removeEventListener("frame", step);
      for (const name of ["pointerdown", "wheel"]) viewer.canvas.removeEventListener(name, byHand);
      if (!this.panel.hidden) this.#fill();
    };
    const byHand = () => this.stop?.();
    viewer.addEventListener("frame", step);
    for (const name of ["pointerdown", "wheel"]) viewer.canvas.addEventListener(name, byHand);
    this.#fill();
  }

  async #film() {
    if (this.filming) return this.filming.abort();
    const { viewer, timeline, path } = this,
      [width, height] = this.size.split("x").map(Number);
    this.stop?.();
    this.filming = new AbortController();
    this.#fill();
    const { film } = await import("./film.js");
    const bar = /** @type {HTMLProgressElement | null} */ (this.panel.querySelector("progress"));
    try {
      const format = { width, height, fps: FPS, seconds: lengthOf(path) };
      const blob = await film(viewer, timeline, path, format, (done) => bar && (bar.value = done), this.filming.signal);
      download(blob, `${path.name || "film"}.${blob.type.startsWith("video/mp4") ? "mp4" : "webm"}`);
      toast("Film saved");
    } catch (error) {
      if (!this.filming.signal.aborted) toast(/** @type {Error} */ (error).message);
    }
    this.filming = null;
    if (!this.panel.hidden) this.#fill();
  }

  /** One viewpoint. @param {import("../view/path.js").Key} key @param {number} i */
  #row(key, i) {
    const row = document.createElement("div");
    row.className = "viewpoint";
    const name = Object.assign(document.createElement("input"), {
      value: key.name,
      maxLength: 60,
      ariaLabel: `Name of viewpoint ${i + 1}`,
    });
    name.onchange = () => this.#edit(i, { name: name.value });
    const time = Object.assign(document.createElement("input"), {
      type: "number",
      min: "0",
      max: "3600",
      step: "0.5",
      value: String(key.seconds),
      ariaLabel: `Time of viewpoint ${i + 1}, seconds`,
    });
    time.onchange = () => this.#edit(i, { seconds: Math.max(0, Number(time.value)) });
    const pose = fromText(key.camera);
    const go = Object.assign(
      menuItem(String(i + 1), "", null, () => pose && this.viewer.stance.moveTo(pose)),
      { title: "Go there" },
    );
    go.setAttribute("aria-label", `Go to viewpoint ${i + 1}`);
    const away = menuItem("✕", "", null, () => this.#set({ keys: this.path.keys.filter((_, j) => j !== i) }));
    away.setAttribute("aria-label", `Remove viewpoint ${i + 1}`);
    row.append(go, name, time, away);
    return row;
  }

  #fill() {
    const { path } = this,
      isPath = path.keys.length > 1;
    const title = Object.assign(document.createElement("input"), {
      value: path.name,
      maxLength: 60,
      placeholder: "Name of the path",
      ariaLabel: "Name of the path",
    });
    title.onchange = () => this.#change({ ...this.path, name: title.value }, true);
    const size = Object.assign(document.createElement("select"), { ariaLabel: "Size of the film" });
    size.append(...SIZES.map((text) => new Option(text.replace("x", " × "), text, false, text === this.size)));
    size.onchange = () => (this.size = size.value);
    this.panel.replaceChildren(
      title,
      ...path.keys.map((key, i) => this.#row(key, i)),
      menuItem("Add this view", "", null, () => this.add()),
      ...(isPath
        ? [
            menuItem(this.stop ? "Stop" : "Play", "", null, () => this.toggle()),
            menuItem("Loop", "", path.loops, () => this.#set({ loops: !this.path.loops })),
            ...(this.viewer.thin || !("MediaRecorder" in window)
              ? []
              : [
                  menuItem(this.filming ? "Stop filming" : "Save a film", "", null, () => this.#film()),
                  this.filming
                    ? Object.assign(document.createElement("progress"), { max: 1, value: 0, ariaLabel: "Film" })
                    : size,
                ]),
          ]
        : []),
      ...(path.keys.length
        ? [
            menuItem("Save the path", ".json", null, () =>
              download(new Blob([toJson(this.path)], { type: "application/json" }), `${this.path.name || "path"}.json`),
            ),
          ]
        : []),
    );
  }
}
