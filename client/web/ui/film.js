/**
 * A film of a camera path: every picture is drawn at the film's own size, however long that takes; then they are played
 * at their pace to the browser's recorder, which writes WebM, or MP4 where it can.
 */

import { poseAt } from "../view/path.js";

/** @typedef {import("../view/viewer.js").Viewer} Viewer */
/** @typedef {{ width: number, height: number, fps: number }} Format */

const TYPES = [
  "video/mp4;codecs=avc1.640028",
  "video/mp4",
  "video/webm;codecs=vp9",
  "video/webm;codecs=vp8",
  "video/webm",
];
const BITS_A_PIXEL = 0.2; // and picture
const WAIT_MS = 5000; // for one picture

/**
 * The next picture, of `version` if that is given.
 * @param {Viewer} viewer
 * @param {number | null} version
 * @returns {Promise<void>}
 */
const nextPicture = (viewer, version) =>
  new Promise((resolve, reject) => {
    /** @param {Event} event */
    const look = (event) => {
      if (version !== null && /** @type {CustomEvent} */ (event).detail.version !== version) return;
      done();
      resolve();
    };
    const timer = setTimeout(() => {
      done();
      reject(new Error("a picture of the film did not come"));
    }, WAIT_MS);
    const done = () => {
      clearTimeout(timer);
      viewer.removeEventListener("picture", look);
    };
    viewer.addEventListener("picture", look);
  });

/**
 * Draw all pictures of the film, in its own size and time.
 * @param {Viewer} viewer
 * @param {import("./timeline.js").Timeline} timeline
 * @param {import("../view/path.js").Path} path
 * @param {Format & { count: number, goesOn: boolean }} format - goesOn: time goes on from here, else it stands still
 * @param {(done: number) => void} tell
 * @param {AbortSignal} signal
 */
async function draw(viewer, timeline, path, { width, height, fps, count, goesOn }, tell, signal) {
  const { canvas, stance, painter } = viewer,
    begin = timeline.position && timeline.strip.placeOf(timeline.position);
  /** @type {Blob[]} */
  const pictures = [];
  let version = timeline.version;
  for (let i = 0; i < count; i++) {
    signal.throwIfAborted();
    const to = goesOn && begin !== null ? timeline.strip.positionAt(begin + i / fps) : null;
    if (to && to.version !== version) {
      const comes = nextPicture(viewer, to.version);
      timeline.showMoment(to.version, to.epoch);
      await comes;
      ({ version } = to);
    }
    stance.pose = poseAt(path, i / fps) ?? stance.pose;
    const comes = nextPicture(viewer, null);
    viewer.lookFrom(stance.pose);
    await comes;
    [canvas.width, canvas.height] = [width, height];
    painter.renderer.draw({ ...viewer.view(), share: 1 });
    pictures.push(
      await new Promise((resolve, reject) =>
        painter.renderer.canvas.toBlob(
          (blob) => (blob ? resolve(blob) : reject(new Error("a picture of the film could not be kept"))),
          "image/webp",
          0.95,
        ),
      ),
    );
    tell((i + 1) / count);
  }
  return pictures;
}

/**
 * Play pictures to the recorder, at their pace.
 * @param {Blob[]} pictures
 * @param {Format} format
 * @param {AbortSignal} signal
 * @returns {Promise<Blob>}
 */
async function record(pictures, { width, height, fps }, signal) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
  const mimeType = TYPES.find((type) => MediaRecorder.isTypeSupported(type));
  const recorder = new MediaRecorder(canvas.captureStream(fps), {
    mimeType,
    videoBitsPerSecond: BITS_A_PIXEL * width * height * fps,
  });
  /** @type {Blob[]} */
  const parts = [];
  recorder.ondataavailable = ({ data }) => parts.push(data);
  const stopped = new Promise((resolve) => (recorder.onstop = resolve));
  let next = createImageBitmap(pictures[0]);
  context.drawImage(await next, 0, 0);
  recorder.start();
  const begin = performance.now();
  for (let i = 0; i < pictures.length && !signal.aborted; i++) {
    const picture = await next;
    if (i + 1 < pictures.length) next = createImageBitmap(pictures[i + 1]);
    await new Promise((resolve) => setTimeout(resolve, begin + (1000 * i) / fps - performance.now()));
    context.drawImage(picture, 0, 0);
    picture.close();
  }
  await new Promise((resolve) => setTimeout(resolve, 1000 / fps));
  recorder.stop();
  await stopped;
  signal.throwIfAborted();
  return new Blob(parts, { type: recorder.mimeType });
}

/**
 * A film of `path`, once along it, from the moment that is shown; time goes on in a recording that plays, else it stands.
 * @param {Viewer} viewer
 * @param {import("./timeline.js").Timeline} timeline
 * @param {import("../view/path.js").Path} path
 * @param {Format & { seconds: number }} format
 * @param {(done: number) => void} tell - share of the pictures drawn
 * @param {AbortSignal} signal
 * @returns {Promise<Blob>}
 */
export async function film(viewer, timeline, path, format, tell, signal) {
  const { canvas, stance } = viewer,
    { pose } = stance,
    stood = timeline.stands,
    wasLive = timeline.status?.mode === "live" && !timeline.recording;
  if (!stood) timeline.pause();
  viewer.presenting = true; // the page draws nothing meanwhile
  try {
    const count = Math.max(1, Math.round(format.seconds * format.fps));
    const pictures = await draw(
      viewer,
      timeline,
      path,
      { ...format, count, goesOn: !stood && timeline.recording },
      tell,
      signal,
    );
    return await record(pictures, format, signal);
  } finally {
    viewer.presenting = false;
    [canvas.width, canvas.height] = [1, 1];
    viewer.resize();
    stance.moveTo(pose, false);
    if (!stood && wasLive) timeline.live();
    else if (!stood) timeline.play();
  }
}
