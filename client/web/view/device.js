/** A camera of this device: chosen, opened, held still in exposure, focus and colour; its pictures with their times. */

/** What a browser may let one hold, and in which words: the mode, and values that a manual mode needs. */
const HOLDABLE = [
  { name: "exposure", mode: "exposureMode", values: ["exposureTime", "iso"] },
  { name: "focus", mode: "focusMode", values: ["focusDistance"] },
  { name: "white balance", mode: "whiteBalanceMode", values: ["colorTemperature"] },
];

const SLOW = 0.9; // of the rate that is wanted, below which it is worth a word

/** @typedef {{ id: string, label: string }} Device */
/** @typedef {{ held: string[], free: string[] }} Held - by name: what stays as it is, and what the browser may change */

/** As rooms sound: what calls need would change it. @type {MediaTrackConstraints} */
const SOUND = { channelCount: { ideal: 1 }, echoCancellation: false, noiseSuppression: false, autoGainControl: false };

/**
 * @param {string} deviceId - empty for the rear one
 * @param {{ width: number, height: number }} size
 * @param {number} fps
 * @param {boolean} sound - of its microphone, too
 */
export function openCamera(deviceId, { width, height }, fps, sound) {
  const long = Math.max(width, height),
    short = Math.min(width, height); // phones count along the sensor, however they are held
  return navigator.mediaDevices.getUserMedia({
    audio: sound && SOUND,
    video: {
      width: { ideal: long },
      height: { ideal: short },
      frameRate: { ideal: fps },
      .../** @type {MediaTrackConstraints} */ ({ resizeMode: "none" }), // as the sensor gives them: no upright picture is cropped to one across
      ...(deviceId ? { deviceId: { exact: deviceId } } : { facingMode: { ideal: "environment" } }),
    },
  });
}

/** The cameras of this device, rear ones first; they have labels once one was opened. @returns {Promise<Device[]>} */
export async function devices() {
  const all = await navigator.mediaDevices.enumerateDevices();
  const front = (/** @type {MediaDeviceInfo} */ { label }) => Number(/front|user/i.test(label));
  return all
    .filter(({ kind }) => kind === "videoinput")
    .sort((a, b) => front(a) - front(b))
    .map(({ deviceId, label }, row) => ({ id: deviceId, label: label || `camera ${row + 1}` }));
}

/**
 * Hold all that can be held as it is now, or let it go again.
 * @param {MediaStreamTrack} track
 * @param {boolean} hold
 * @returns {Promise<Held>}
 */
export async function holdStill(track, hold) {
  const can = /** @type {any} */ (track.getCapabilities?.() ?? {}),
    now = /** @type {any} */ (track.getSettings());
  /** @type {Held} */
  const found = { held: [], free: [] };
  for (const { name, mode, values } of HOLDABLE) {
    const wanted = hold ? "manual" : "continuous";
    if (can[mode]?.includes(wanted)) {
      const kept = hold
        ? values.filter((value) => value in can && value in now).map((value) => [value, now[value]])
        : [];
      const constraint = /** @type {any} */ ({ advanced: [{ [mode]: wanted, ...Object.fromEntries(kept) }] });
      await track.applyConstraints(constraint).catch(() => {}); // what came of it is seen below
    }
    const mine = /** @type {any} */ (track.getSettings())[mode];
    (mine === "manual" || mine === "none" ? found.held : found.free).push(name);
  }
  return found;
}

/**
 * Call `act` with every new picture of a video and when it was taken, by performance.now(); returns what ends it.
 * @param {HTMLVideoElement} video @param {(takenMs: number) => void} act
 */
export function eachPicture(video, act) {
  let over = false,
    handle = 0;
  /** @type {VideoFrameRequestCallback} */
  const next = (now, { captureTime, presentationTime }) => {
    if (over) return;
    handle = video.requestVideoFrameCallback(next);
    act(captureTime ?? Math.min(now, presentationTime));
  };
  handle = video.requestVideoFrameCallback(next);
  return () => {
    over = true;
    video.cancelVideoFrameCallback(handle);
  };
}

/**
 * The part of a picture that is sent: all of it, or the middle where the shapes differ; null where one is upright and
 * the other is not.
 * @param {{ width: number, height: number }} from @param {{ width: number, height: number }} to
 */
export function part(from, to) {
  if (!from.width || from.width < from.height !== to.width < to.height) return null;
  const scale = Math.min(from.width / to.width, from.height / to.height);
  const width = to.width * scale,
    height = to.height * scale;
  return { x: (from.width - width) / 2, y: (from.height - height) / 2, width, height };
}

/**
 * Whether a camera that gave `rate` pictures a second, counted for about one, gives fewer than are wanted. A count may
 * miss one by when it began.
 * @param {number} rate
 * @param {number} wanted
 */
export const isSlow = (rate, wanted) => rate > 0 && rate + 1 < SLOW * wanted;
