/** The space that the rig has seen, which viewers stay in. */

import { add, dot, unit } from "../lib/vectors.js";
import { between, distanceTo, fromCamera } from "./camera.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./camera.js").Pose} Pose */

/**
 * @typedef {object} SeenSpace
 * @property {Vec3} middle - what the rig looks at
 * @property {number} radius - from there to the farthest camera, world units
 * @property {Vec3[]} directions - from there to each camera, unit length
 */

const FREE_RADII = 1.5,
  MAX_RADII = 4; // as far away as the rig, times this: where the picture begins to fade, and the farthest one can go
const NEAR_SHARE = 0.15; // of the distance to the nearest camera
const FREE_COSINE = Math.cos(0.7),
  GONE_COSINE = Math.cos(1.5); // between the view's side and the nearest camera's

/** @type {(cameras: import("./camera.js").RigCamera[], middle: Vec3) => SeenSpace} */
export function seenSpace(cameras, middle) {
  const away = cameras.map((camera) => add(fromCamera(camera, 1).position, middle, -1));
  return { middle, radius: Math.max(1e-6, ...away.map((v) => Math.hypot(...v))), directions: away.map(unit) };
}

/**
 * Nothing is drawn within this distance of there (`near_radius` in core/scene/expand.py).
 * @type {(position: Vec3, cameras: import("./camera.js").RigCamera[]) => number}
 */
export const nearRadius = (position, cameras) =>
  cameras.length ? NEAR_SHARE * Math.min(...cameras.map((camera) => distanceTo(position, camera))) : 0;

/**
 * The widest angle between the middle of the cameras' directions and one of them, radians.
 * @type {(space: SeenSpace) => number}
 */
export function spread({ directions }) {
  const middle = unit(directions.reduce((sum, direction) => add(sum, direction), /** @type {Vec3} */ ([0, 0, 0])));
  return Math.max(0, ...directions.map((direction) => Math.acos(Math.min(1, Math.max(-1, dot(direction, middle))))));
}

/**
 * A movement from a to b, which takes ever more force outside of what was seen.
 * @type {(space: SeenSpace, a: Pose, b: Pose) => Pose}
 */
export function braked(space, a, b) {
  const before = outside(space, a.position);
  return outside(space, b.position) <= before ? b : between(a, b, (1 - before) ** 2);
}

/** @type {(x: number) => number} */
const clamp = (x) => Math.min(Math.max(x, 0), 1);

/**
 * How far outside of it a place is: 0 inside, 1 where nothing was seen.
 * @type {(space: SeenSpace, position: Vec3) => number}
 */
export function outside({ middle, radius, directions }, position) {
  const away = add(position, middle, -1),
    radii = Math.hypot(...away) / radius;
  const far = clamp((radii - FREE_RADII) / (MAX_RADII - FREE_RADII));
  if (radii < 0.3) return far; // in the middle of it all sides are near
  const side = unit(away),
    nearest = Math.max(...directions.map((direction) => dot(direction, side)));
  return Math.max(far, clamp((FREE_COSINE - nearest) / (FREE_COSINE - GONE_COSINE)));
}

/** The pose, no farther away than it makes sense to go. @type {(space: SeenSpace, pose: Pose) => Pose} */
export function held({ middle, radius }, pose) {
  const away = add(pose.position, middle, -1),
    radii = Math.hypot(...away) / radius;
  if (radii <= MAX_RADII) return pose;
  return { ...pose, position: add(middle, away, MAX_RADII / radii) };
}
