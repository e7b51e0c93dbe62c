/** Facts about a scene: the METADATA chunk, codec/FORMAT.md section 2.1. */

/**
 * The similarity to the coordinates of the calibration: scale * R x + translation.
 * @typedef {{ scale: number, rotation: number[], translation: number[] }} Original
 */
/** @typedef {{ metresPerUnit?: number, up?: number[], epochNs?: bigint, title?: string, licence?: string, original?: Original, exposures?: number[][] }} Metadata */

const MOST = 1e12,
  LEAST = 1e-12,
  MAX_TEXT = 1024,
  MAX_GAIN = 64,
  MAX_OFFSET = 16,
  EXPOSURE_BYTES = 24;
const isLength = (/** @type {number} */ x) => x >= LEAST && x <= MOST;
const areNumbers = (/** @type {number[]} */ values) => values.every((x) => Math.abs(x) <= MOST);
const isDirection = (/** @type {number[]} */ values) => areNumbers(values) && isLength(Math.hypot(...values));

/**
 * What it says; nothing in it is ever refused, and what cannot be read is as if it were not there.
 * @type {(chunk: Uint8Array) => Metadata}
 */
export function readMetadata(chunk) {
  const view = new DataView(chunk.buffer, chunk.byteOffset, chunk.byteLength);
  /** @type {Metadata} */
  const found = {};
  for (let at = 0, before = -1; at + 4 <= chunk.length;) {
    const tag = view.getUint16(at, true),
      length = view.getUint16(at + 2, true),
      start = at + 4;
    at = start + length;
    if (tag <= before || at > chunk.length) break;
    before = tag;
    const numbers =
      length % 8 ? [] : Array.from({ length: length / 8 }, (_, i) => view.getFloat64(start + 8 * i, true));
    if (tag === 1 && length === 8 && isLength(numbers[0])) found.metresPerUnit = numbers[0];
    else if (tag === 2 && length === 24 && isDirection(numbers)) found.up = numbers;
    else if (tag === 3 && length === 8) found.epochNs = view.getBigInt64(start, true);
    else if (tag === 4) found.title = textOf(chunk.subarray(start, at));
    else if (tag === 5) found.licence = textOf(chunk.subarray(start, at));
    else if (tag === 6 && length === 64) found.original = originalOf(numbers);
    else if (tag === 7 && length % EXPOSURE_BYTES === 0)
      found.exposures = exposuresOf(view, start, length / EXPOSURE_BYTES);
  }
  return found;
}

/** @type {(numbers: number[]) => Original | undefined} */
function originalOf(numbers) {
  const scale = numbers[0],
    rotation = numbers.slice(1, 5),
    translation = numbers.slice(5);
  return isLength(scale) && isDirection(rotation) && areNumbers(translation)
    ? { scale, rotation, translation }
    : undefined;
}

/**
 * Gain r g b and offset r g b of each camera.
 * @type {(view: DataView, start: number, count: number) => number[][] | undefined}
 */
function exposuresOf(view, start, count) {
  const found = Array.from({ length: count }, (_, camera) =>
    Array.from({ length: 6 }, (_, i) => view.getFloat32(start + EXPOSURE_BYTES * camera + 4 * i, true)),
  );
  const fits = (/** @type {number[]} */ e) =>
    e.slice(0, 3).every((gain) => gain > 0 && gain <= MAX_GAIN) &&
    e.slice(3).every((offset) => Math.abs(offset) <= MAX_OFFSET);
  return found.every(fits) ? found : undefined;
}

/** One line of text. @type {(bytes: Uint8Array) => string | undefined} */
function textOf(bytes) {
  try {
    const text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
    return text && bytes.length <= MAX_TEXT && !/[\p{Cc}\p{Zl}\p{Zp}]/u.test(text) ? text : undefined;
  } catch {
    return undefined;
  }
}
