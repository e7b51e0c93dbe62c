/** The rig: what points up for it, and its cameras as WebGL engines have them (x right, y up, looking along -z). */

import { add, centre, cross, dot, row, unit } from "./vectors.js";

/** @typedef {import("./vectors.js").Vec3} Vec3 */
/** @typedef {import("../decode/scene.js").RigCamera} RigCamera */

/** World to camera, without the translation. @type {(camera: RigCamera) => number[]} */
const rotationOf = ({ worldToCamera: m }) => [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];

/** Where a camera stands. @type {(camera: RigCamera) => Vec3} */
export const centreOf = (camera) =>
  centre(
    rotationOf(camera),
    [3, 7, 11].map((i) => camera.worldToCamera[i]),
  );

/** The same direction of all cameras, on average. @type {(cameras: RigCamera[], axis: number, sign: number) => Vec3} */
const mean = (cameras, axis, sign) =>
  cameras.reduce((sum, camera) => add(sum, row(rotationOf(camera), axis), sign), /** @type {Vec3} */ ([0, 0, 0]));

/** What points up for most of the rig. @type {(cameras: RigCamera[]) => Vec3} */
export function rigUp(cameras) {
  const sum = mean(cameras, 1, -1);
  return Math.hypot(...sum) > 1e-6 ? unit(sum) : [0, -1, 0];
}

/** Columns of a matrix, with zeros and a one below. @type {(x: Vec3, y: Vec3, z: Vec3, place: Vec3) => number[]} */
const matrix = (x, y, z, place) => [...x, 0, ...y, 0, ...z, 0, ...place, 1];

/**
 * The matrix that sets a stream upright in an engine's scene: up for the rig becomes y, ahead becomes -z.
 * @param {RigCamera[]} cameras
 * @returns {number[]} 16 numbers, column by column
 */
export function upright(cameras) {
  const y = rigUp(cameras),
    ahead = mean(cameras, 2, 1),
    level = add(ahead, y, -dot(ahead, y));
  const z = unit(
    Math.hypot(...level) > 1e-6
      ? add([0, 0, 0], level, -1)
      : Math.abs(y[2]) < 0.9
        ? add([0, 0, -1], y, y[2])
        : add([0, -1, 0], y, y[1]),
  );
  const x = cross(y, z);
  return matrix([x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]], [0, 0, 0]);
}

/**
 * A camera of the rig for an engine: its pose among the splats, and its field of view.
 * @param {RigCamera} camera
 * @returns {{ pose: number[], fov: number }} 16 numbers, column by column, camera to world; degrees, vertically
 */
export function viewOf(camera) {
  const r = rotationOf(camera),
    back = /** @type {(v: Vec3) => Vec3} */ (([x, y, z]) => [-x, -y, -z]);
  const fov = (360 / Math.PI) * Math.atan(camera.height / (2 * camera.intrinsics[4]));
  return { pose: matrix(row(r, 0), back(row(r, 1)), back(row(r, 2)), centreOf(camera)), fov };
}
