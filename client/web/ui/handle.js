/** `window.streamlod`, and the same over postMessage for pages that embed the viewer (docs/viewer.md, "For programs"). */

import { fromText, toText } from "../view/camera.js";

const VERSION = 1; // of the messages
const EVENTS = ["status", "scene", "picture", "refused"];
const METHODS = ["state", "seek", "play", "pause", "step", "loop", "setCamera", "captureFrame", "inspect", "destroy"];

/** @type {(condition: unknown, text: string) => asserts condition} */
function need(condition, text) {
  if (!condition) throw new TypeError(text);
}

/**
 * @param {import("../view/viewer.js").Viewer} viewer
 * @param {import("./timeline.js").Timeline} timeline
 * @param {import("./status.js").Delay} delay
 * @param {() => void} destroy
 */
export function createHandle(viewer, timeline, delay, destroy) {
  const handle = {
    /** What is going on now. */
    get state() {
      const { status, picture } = viewer;
      return {
        phase: status?.phase ?? "connecting",
        source: status?.source ?? null,
        mode: status?.mode ?? "live",
        behindSeconds: status?.lagSeconds ?? null,
        latencyMs: delay.seconds === null ? null : Math.round(1000 * delay.seconds),
        fraction: status?.fraction ?? null,
        position: status?.position ?? null,
        window: status?.window ?? null,
        version: picture?.version ?? null,
        splats: picture?.splats ?? 0,
        fps: viewer.pace.fps,
        camera: toText(viewer.stance.pose),
        viewers: viewer.watchers,
        sound: viewer.sound?.state ?? null,
      };
    },
    /** @type {(name: string, listener: (detail: any) => void) => () => void} returns the way to stop listening */
    on(name, listener) {
      /** @param {Event} event */
      const relay = (event) => listener(/** @type {CustomEvent} */ (event).detail);
      viewer.addEventListener(name, relay);
      return () => viewer.removeEventListener(name, relay);
    },
    /** @type {(version: number | "live") => void} */
    seek(version) {
      need(version === "live" || Number.isInteger(version), 'seek takes a frame number or "live"');
      need(timeline.window, "nothing can be sought yet");
      if (version === "live") timeline.live();
      else timeline.seek(version);
    },
    play: () => void (timeline.stands && timeline.toggle()),
    pause: () => timeline.pause(),
    /** @type {(frames: number) => void} */
    step(frames) {
      need(Number.isInteger(frames), "step takes a number of frames");
      timeline.step(frames);
    },
    /** @type {(loop: boolean) => void} */
    loop(loop) {
      need(typeof loop === "boolean", "loop takes true or false");
      timeline.setLoop(loop);
    },
    /**
     * Stand at a rig camera (number), or where a text of `state.camera` says.
     * @type {(camera: number | string) => void}
     */
    setCamera(camera) {
      const rig = typeof camera === "number" && viewer.scene?.cameras[camera],
        pose = rig ? null : fromText(String(camera));
      need(rig || pose, "no such camera");
      viewer.stance.posed = true;
      if (pose) viewer.stance.moveTo(pose, false);
      else viewer.stance.standAt(/** @type {any} */ (rig), false);
    },
    /** A PNG of what is seen. @returns {Promise<Blob>} */
    captureFrame: () => viewer.capture(),
    /** The decoder's state, to compare decoders with. */
    inspect: () => viewer.inspect(),
    destroy,
  };
  return handle;
}

/** Answer every call of the embedding page, by a result or an error. @param {ReturnType<typeof createHandle>} handle */
export function listenToParent(handle) {
  if (window.parent === window) return;
  let gone = false;
  /** @param {string} event */
  const tell = (event) =>
    window.parent.postMessage({ streamlod: "event", version: VERSION, event, state: handle.state }, "*");
  for (const name of EVENTS) handle.on(name, () => tell(name));
  /** @param {any} call */
  const answer = async ({ streamlod: method, version = VERSION, arguments: all = [] }) => {
    need(version === VERSION, `this page speaks version ${VERSION} of the messages`);
    need(
      METHODS.includes(method),
      `there is no method ${String(method).slice(0, 40)}; there are ${METHODS.join(", ")}`,
    );
    need(Array.isArray(all), "arguments must be an array");
    need(!gone, "the player was destroyed");
    if (method === "state") return handle.state;
    gone = method === "destroy";
    return (await /** @type {any} */ (handle)[method](...all)) ?? null;
  };
  window.addEventListener("message", async ({ data, source, origin }) => {
    if (source !== window.parent || typeof data !== "object" || data?.streamlod === undefined) return;
    const head = { streamlod: "answer", version: VERSION, id: data.id ?? null };
    const reply = await answer(data).then(
      (result) => ({ ...head, result }),
      (error) => ({ ...head, error: error instanceof Error ? error.message : String(error) }),
    );
    window.parent.postMessage(reply, origin === "null" ? "*" : origin);
  });
  tell("ready");
}
