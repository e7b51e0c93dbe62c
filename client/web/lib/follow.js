/** A stream or a recording, frame after frame, in its own time. */

/**
 * @typedef {import("./streamlod.js").Clip} Clip
 * @typedef {import("./streamlod.js").Live} Live
 * @typedef {import("./frame.js").Frame} Frame
 */

/** The next time that the browser draws; under node, soon. @type {() => Promise<unknown>} */
const nextPicture = () =>
  new Promise((resolve) =>
    (globalThis.requestAnimationFrame ?? ((/** @type {() => void} */ then) => setTimeout(then, 10)))(resolve),
  );

/**
 * Hand frames to `take`: those of a live stream as they come; those of a recording at the times at which they were
 * filmed, over and over. The first one that is handed over says that all of it changed.
 * @param {Clip | Live} source
 * @param {(frame: Frame) => void} take
 * @param {AbortSignal} [signal] - ends it
 * @returns {Promise<void>} once it is ended; rejected where a recording cannot be read any more, or `take` throws
 */
export async function follow(source, take, signal) {
  const first = await source.frame(0);
  if (signal?.aborted) return;
  take({ ...first, changes: [{ first: 0, count: first.count }], isNew: true });
  if ("times" in source) await replay(source, take, signal);
  else await listen(source, take, signal);
}

/** @param {Clip} clip @param {(frame: Frame) => void} take @param {AbortSignal} [signal] */
async function replay(clip, take, signal) {
  const begin = performance.now(),
    length = clip.duration + 1 / (clip.scene.fps || 30); // the last frame is seen as long as any
  for (;;) {
    await nextPicture();
    const frame = await clip.frame(((performance.now() - begin) / 1000) % length);
    if (signal?.aborted) return;
    if (frame.changes.length) take(frame);
  }
}

/** @param {Live} live @param {(frame: Frame) => void} take @param {AbortSignal} [signal] @returns {Promise<void>} */
const listen = (live, take, signal) =>
  new Promise((resolve, reject) => {
    /** @param {Event} event */
    const heard = (event) => {
      try {
        take(/** @type {CustomEvent<Frame>} */ (event).detail);
      } catch (error) {
        live.removeEventListener("frame", heard);
        reject(error);
      }
    };
    live.addEventListener("frame", heard);
    signal?.addEventListener("abort", () => {
      live.removeEventListener("frame", heard);
      resolve();
    });
  });
