/** Vectors of three numbers, and rows of rotations (9 numbers, row by row). */

/** @typedef {[number, number, number]} Vec3 */

/** @type {(a: ArrayLike<number>, b: ArrayLike<number>) => number} */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @type {(a: Vec3, b: Vec3) => Vec3} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @type {(a: Vec3, b: Vec3, s?: number) => Vec3} a + s b */
export const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
/** @type {(a: Vec3) => Vec3} */
export const unit = (a) => {
  const length = Math.hypot(...a) || 1;
  return [a[0] / length, a[1] / length, a[2] / length];
};
/** @type {(r: ArrayLike<number>, row: number) => Vec3} */
export const row = (r, i) => [r[3 * i], r[3 * i + 1], r[3 * i + 2]];

/** Where a camera stands that maps x to r x + t. @type {(r: number[], t: ArrayLike<number>) => Vec3} */
export const centre = (r, t) =>
  /** @type {Vec3} */ ([0, 1, 2].map((i) => -r[i] * t[0] - r[3 + i] * t[1] - r[6 + i] * t[2]));
