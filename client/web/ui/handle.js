/** `window.streamlod` and the same over postMessage, for pages that embed the viewer. */

import { fromCamera, fromText, toText } from "../view/camera.js";

/** @typedef {import("../view/viewer.js").Viewer} Viewer */
/** @typedef {import("./timeline.js").Timeline} Timeline */

const EVENTS = ["status", "scene", "picture", "refused"];

/**
 * @param {Viewer} viewer
 * @param {Timeline} timeline
 * @param {import("./status.js").Latency} latency
 * @param {() => void} destroy
 */
export function createHandle(viewer, timeline, latency, destroy) {
  const handle = {
    /** What is going on now. */
    get state() {
      const { status, picture } = viewer;
      return {
        phase: status?.phase ?? "connecting", source: status?.source ?? null, mode: status?.mode ?? "live",
        behindSeconds: status?.lagSeconds ?? null, latencyMs: latency.ms, fraction: status?.fraction ?? null, position: status?.position ?? null, window: status?.window ?? null,
        version: picture?.version ?? null, splats: picture?.splats ?? 0, fps: viewer.fps, camera: toText(viewer.pose),
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
    seek: (version) => (version === "live" ? timeline.live() : timeline.seek(version)),
    play: () => timeline.stands && timeline.toggle(),
    pause: () => timeline.pause(),
    /** @type {(frames: number) => void} */
    step: (frames) => timeline.step(frames),
    /** @type {(loop: boolean) => void} */
    loop: (loop) => timeline.setLoop(loop),
    /** Stand at a rig camera (number), or where a text of `state.camera` says. @type {(camera: number | string) => void} */
    setCamera(camera) {
      const rig = typeof camera === "number" ? viewer.scene?.cameras[camera] : null;
      const pose = rig ? fromCamera(rig, viewer.pose.distance) : fromText(String(camera));
      if (!pose) throw new Error("no such camera");
      viewer.posed = true;
      viewer.moveTo(pose, false);
    },
    /** A PNG of what is seen. @returns {Promise<Blob>} */
    captureFrame: () => viewer.capture(),
    /** The decoder's state, to compare decoders with. */
    inspect: () => viewer.inspect(),
    destroy,
  };
  return handle;
}

/** Answer `{streamlod: METHOD, arguments: [...]}` from the embedding page, and tell it events. @param {ReturnType<typeof createHandle>} handle */
export function listenToParent(handle) {
  if (window.parent === window) return;
  for (const name of EVENTS) {
    handle.on(name, () => window.parent.postMessage({ streamlod: "event", event: name, state: handle.state }, "*"));
  }
  const methods = ["seek", "play", "pause", "step", "loop", "setCamera", "captureFrame", "destroy"];
  window.addEventListener("message", async ({ data, source, origin }) => {
    if (source !== window.parent || !methods.includes(data?.streamlod)) return;
    const answer = { streamlod: "answer", id: data.id ?? null };
    try {
      const result = await /** @type {any} */ (handle)[data.streamlod](...(data.arguments ?? []));
      window.parent.postMessage({ ...answer, result: result ?? null }, origin);
    } catch (error) {
      window.parent.postMessage({ ...answer, error: String(error) }, origin);
    }
  });
}
