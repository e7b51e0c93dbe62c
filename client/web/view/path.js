/**
 * A way of the camera: named viewpoints with times, and the pose between them; as text for a link and as JSON for files,
 * which `streamlod view --path` reads (client/viewpoints.py interpolates alike). No page needed.
 */

import { fromNumbers, fromText, numbersOf } from "./camera.js";

/** @typedef {import("./camera.js").Pose} Pose */
/** @typedef {{ seconds: number, camera: string, name: string }} Key - camera: a text of `toText` */
/** @typedef {{ name: string, loops: boolean, keys: Key[] }} Path - keys: ascending in time, from 0 on */

const FORMAT = 1;
export const MAX_KEYS = 64;
const MAX_SECONDS = 3600,
  MAX_CHARACTERS = 60; // of a name

/** @type {Path} */
export const EMPTY = { name: "", loops: false, keys: [] };

/** @param {Path} path */
export const lengthOf = ({ keys }) => keys.at(-1)?.seconds ?? 0;

/**
 * The pose at a time; before the first viewpoint and after the last one, theirs.
 * @type {(path: Path, seconds: number) => Pose | null} null: there is no viewpoint
 */
export function poseAt({ keys, loops }, seconds) {
  const last = keys.length - 1,
    end = keys[last]?.seconds ?? 0;
  if (last < 0) return null;
  const t = loops && end > 0 ? ((seconds % end) + end) % end : Math.min(Math.max(seconds, 0), end);
  let i = 0;
  while (i < last - 1 && keys[i + 1].seconds <= t) i++;
  const here = /** @type {Pose} */ (fromText(keys[i].camera));
  if (last === 0) return here;
  const values = keys.map(({ camera }) => numbersOf(camera)),
    span = keys[i + 1].seconds - keys[i].seconds,
    s = (t - keys[i].seconds) / span;
  // Cubic Hermite, each slope that between the neighbours (Catmull and Rom, with times).
  /** @type {(k: number, n: number) => number} */
  const slope = (k, n) => {
    const [a, b] = [Math.max(0, k - 1), Math.min(last, k + 1)];
    return (span * (values[b][n] - values[a][n])) / (keys[b].seconds - keys[a].seconds);
  };
  const s2 = s * s,
    s3 = s2 * s;
  const mixed = values[i].map(
    (from, n) =>
      (2 * s3 - 3 * s2 + 1) * from +
      (3 * s2 - 2 * s3) * values[i + 1][n] +
      (s3 - 2 * s2 + s) * slope(i, n) +
      (s3 - s2) * slope(i + 1, n),
  );
  return fromNumbers(mixed) ?? here;
}

/** @type {(condition: unknown, text: string) => asserts condition} */
function need(condition, text) {
  if (!condition) throw new TypeError(text);
}

/** @type {(x: unknown) => string} */
const shortened = (x) => String(x ?? "").slice(0, MAX_CHARACTERS);

/** What a file or a link says, checked. @param {any} told @returns {Path} @throws {TypeError} */
export function checked(told) {
  need(told?.version === FORMAT, "this is no camera path of a version that the page knows");
  need(Array.isArray(told.keys) && told.keys.length <= MAX_KEYS, `a camera path has at most ${MAX_KEYS} viewpoints`);
  let before = -1;
  const keys = told.keys.map((/** @type {any} */ key, /** @type {number} */ i) => {
    const seconds = key?.seconds,
      camera = String(key?.camera);
    need(
      typeof seconds === "number" && seconds > before && seconds >= 0 && seconds <= MAX_SECONDS,
      `viewpoint ${i + 1}: its time must be later than that of the one before`,
    );
    need(fromText(camera), `viewpoint ${i + 1}: there is no such camera`);
    before = seconds;
    return { seconds, camera, name: shortened(key.name) };
  });
  return { name: shortened(told.name), loops: told.loops === true, keys };
}

/** @type {(path: Path) => string} */
export const toJson = (path) => JSON.stringify({ version: FORMAT, ...path }, null, 1);

/** @type {(text: string) => string} for use between `_` and `~` */
const escaped = (text) => encodeURIComponent(text).replace(/[_~]/g, (c) => (c === "_" ? "%5F" : "%7E"));

/** For a link, and back. @type {(path: Path) => string} */
export const toLink = ({ name, loops, keys }) =>
  [escaped(name), Number(loops), ...keys.map((key) => `${key.seconds}_${key.camera}_${escaped(key.name)}`)].join("~");

/** @type {(text: string) => Path} @throws {TypeError} where it is no such text */
export function fromLink(text) {
  try {
    const [name, loops, ...keys] = text.split("~", MAX_KEYS + 3);
    return checked({
      version: FORMAT,
      name: decodeURIComponent(name),
      loops: loops === "1",
      keys: keys.map((key) => {
        const [seconds, camera, title] = key.split("_");
        return { seconds: Number(seconds), camera, name: decodeURIComponent(title ?? "") };
      }),
    });
  } catch (error) {
    throw new TypeError("the link's camera path cannot be read", { cause: error });
  }
}
