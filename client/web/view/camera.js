/**
 * Where the viewer stands: poses and ways to move them. Functions return new poses.
 *
 * Axes as everywhere in streamlod: x right, y down, z forward; `rotation` holds the world-to-camera rows.
 */

import { add, centre, cross, dot, row, unit } from "../lib/vectors.js";

/** @typedef {import("../lib/vectors.js").Vec3} Vec3 */

/**
 * @typedef {object} Pose
 * @property {number[]} rotation - 9 numbers, row by row, world to camera
 * @property {Vec3} position - camera centre, world units
 * @property {number} distance - to the point that orbiting goes around, world units
 * @property {number} focal - focal length as a fraction of the picture's height
 * @property {number} stretch - horizontal focal length over the vertical one
 * @property {[number, number]} shift - principal point minus picture centre, as fractions of the picture's height
 */

/** @typedef {import("../decode/scene.js").RigCamera} RigCamera */

/** @type {(v: Vec3, axis: Vec3, angle: number) => Vec3} Rodrigues' rotation */
function turn(v, axis, angle) {
  const c = Math.cos(angle),
    s = Math.sin(angle);
  const across = cross(axis, v),
    along = dot(axis, v) * (1 - c);
  return [
    v[0] * c + across[0] * s + axis[0] * along,
    v[1] * c + across[1] * s + axis[1] * along,
    v[2] * c + across[2] * s + axis[2] * along,
  ];
}

/** From a place to a camera of the rig. @type {(position: Vec3, camera: RigCamera) => number} */
export const distanceTo = (position, camera) => Math.hypot(...add(fromCamera(camera, 1).position, position, -1));

/** The point that orbiting goes around. @type {(pose: Pose) => Vec3} */
export const target = (pose) => add(pose.position, row(pose.rotation, 2), pose.distance);

/** @type {(rotation: number[], axis: Vec3, angle: number) => number[]} */
const turnRows = (rotation, axis, angle) => [0, 1, 2].flatMap((i) => turn(row(rotation, i), axis, angle));

const STEEPEST = 0.999; // cosine between the view and `up` at which pitching stops

/**
 * Turn the view, standing still: to the right about `up`, and upwards; radians.
 * @type {(pose: Pose, up: Vec3, yaw: number, pitch: number) => Pose}
 */
export function look(pose, up, yaw, pitch) {
  let rotation = turnRows(pose.rotation, up, -yaw);
  const pitched = turnRows(rotation, row(rotation, 0), pitch);
  const steep = dot(row(pitched, 2), up),
    before = dot(row(rotation, 2), up);
  if (Math.abs(steep) < STEEPEST || Math.abs(steep) < Math.abs(before)) rotation = pitched;
  return { ...pose, rotation: orthonormal(rotation) };
}

/** Go around the target; arguments as in `look`. @type {(pose: Pose, up: Vec3, yaw: number, pitch: number) => Pose} */
export function orbit(pose, up, yaw, pitch) {
  const turned = look(pose, up, yaw, pitch);
  return { ...turned, position: add(target(pose), row(turned.rotation, 2), -pose.distance) };
}

/**
 * Shift camera and target to the right and down, by fractions of the picture's height at the target.
 * @type {(pose: Pose, dx: number, dy: number) => Pose}
 */
export function pan(pose, dx, dy) {
  const scale = pose.distance / pose.focal;
  const moved = add(add(pose.position, row(pose.rotation, 0), dx * scale), row(pose.rotation, 1), dy * scale);
  return { ...pose, position: moved };
}

/** Move towards (factor < 1) or away from the target. @type {(pose: Pose, factor: number) => Pose} */
export function zoom(pose, factor) {
  const distance = Math.min(Math.max(pose.distance * factor, 1e-3), 1e6);
  return { ...pose, distance, position: add(target(pose), row(pose.rotation, 2), -distance) };
}

/** Fly by (right, down, forward) world units, the target with it. @type {(pose: Pose, by: Vec3) => Pose} */
export function fly(pose, by) {
  let position = pose.position;
  for (let i = 0; i < 3; i++) position = add(position, row(pose.rotation, i), by[i]);
  return { ...pose, position };
}

/** Turn towards `point` and orbit around it from now on. @type {(pose: Pose, point: Vec3, up: Vec3) => Pose} */
export function focusOn(pose, point, up) {
  const away = add(point, pose.position, -1);
  const distance = Math.hypot(...away);
  if (distance < 1e-6) return pose;
  const forward = unit(away);
  let right = cross(forward, up);
  if (Math.hypot(...right) < 1e-3) right = row(pose.rotation, 0);
  right = unit(right);
  return { ...pose, distance, rotation: [...right, ...cross(forward, right), ...forward], shift: [0, 0] };
}

/** @type {(camera: RigCamera, distance: number) => Pose} */
export function fromCamera(camera, distance) {
  const m = camera.worldToCamera,
    k = camera.intrinsics,
    h = camera.height;
  const rotation = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
  return {
    rotation,
    position: centre(rotation, [m[3], m[7], m[11]]),
    distance,
    focal: k[4] / h,
    stretch: k[0] / k[4],
    shift: [(k[2] - camera.width / 2) / h, (k[5] - h / 2) / h],
  };
}

/** The camera nearest to the middle of the rig, where a visit begins. @type {(cameras: RigCamera[]) => number} */
export function homeCamera(cameras) {
  /** @type {Vec3} */
  let middle = [0, 0, 0];
  for (const camera of cameras) middle = add(middle, fromCamera(camera, 1).position, 1 / cameras.length);
  const reach = cameras.map((camera) => distanceTo(middle, camera));
  return Math.max(0, reach.indexOf(Math.min(...reach)));
}

/** The pose `t` of the way from a to b, 0 to 1. @type {(a: Pose, b: Pose, t: number) => Pose} */
export function between(a, b, t) {
  /** @type {(x: number, y: number) => number} */
  const mix = (x, y) => x + (y - x) * t;
  return {
    rotation: orthonormal(a.rotation.map((x, i) => mix(x, b.rotation[i]))),
    position: add(a.position, add(b.position, a.position, -1), t),
    distance: mix(a.distance, b.distance),
    focal: mix(a.focal, b.focal),
    stretch: mix(a.stretch, b.stretch),
    shift: [mix(a.shift[0], b.shift[0]), mix(a.shift[1], b.shift[1])],
  };
}

/** The nearest rotation that keeps the view direction. @type {(r: number[]) => number[]} */
function orthonormal(r) {
  const forward = unit(row(r, 2));
  const down = row(r, 1);
  const right = unit(cross(down, forward));
  return [...right, ...cross(forward, right), ...forward];
}

/** A pose as text for a link, and back. @type {(pose: Pose) => string} */
export function toText(pose) {
  const numbers = [...pose.position, ...row(pose.rotation, 2), ...row(pose.rotation, 1), pose.distance, pose.focal];
  return [...numbers, ...pose.shift, pose.stretch].map((x) => Number(x.toFixed(4))).join(",");
}

/** The numbers of such a text. @type {(text: string | null) => number[]} */
export const numbersOf = (text) => (text ?? "").split(",").map(Number);

/** @type {(text: string | null) => Pose | null} null when the text is not a pose */
export const fromText = (text) => fromNumbers(numbersOf(text));

/** @type {(n: number[]) => Pose | null} null when they are no pose */
export function fromNumbers(n) {
  if (n.length !== 14 || !n.every(Number.isFinite) || n[9] <= 0 || n[10] <= 0 || n[13] <= 0) return null;
  const [px, py, pz, fx, fy, fz, dx, dy, dz, distance, focal, sx, sy, stretch] = n;
  if (Math.hypot(...cross([dx, dy, dz], [fx, fy, fz])) < 1e-3) return null;
  const rotation = orthonormal([0, 0, 0, dx, dy, dz, fx, fy, fz]);
  return { rotation, position: [px, py, pz], distance, focal, stretch, shift: [sx, sy] };
}
