/** The way of a flight across the rig. No page needed. */

import { add, cross, dot, unit } from "../lib/vectors.js";
import { orbit } from "./camera.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("./camera.js").Pose} Pose */

const WITHIN = 0.9; // of the rig's width to each side
const MAX_TURN = 1.3,
  MIN_TURN = 0.12; // radians to one side

/**
 * How far one can go around to each side without leaving the rig, radians.
 * @type {(space: import("./limits.js").SeenSpace | null, pose: Pose, up: Vec3) => [number, number]}
 */
export function turns(space, pose, up) {
  if (!space) return [-MIN_TURN, MIN_TURN];
  const flat = (/** @type {Vec3} */ v) => unit(add(v, up, -dot(v, up)));
  const angle = (/** @type {Vec3} */ a, /** @type {Vec3} */ b) => Math.atan2(dot(cross(a, b), up), dot(a, b));
  const side = (/** @type {Pose} */ at) => flat(add(at.position, space.middle, -1));
  const here = side(pose),
    sign = Math.sign(angle(here, side(orbit(pose, up, 0.05, 0)))) || 1; // of what orbiting to the right does
  const reach = space.directions.map((direction) => sign * WITHIN * angle(here, flat(direction)));
  const [left, right] = [Math.min(0, ...reach), Math.max(0, ...reach)];
  return [Math.min(Math.max(left, -MAX_TURN), -MIN_TURN), Math.max(Math.min(right, MAX_TURN), MIN_TURN)];
}

/**
 * Where a flight has turned to after a share of its time: right, left, and back.
 * @type {(share: number, turns: [number, number]) => number}
 */
export function turnAt(share, [left, right]) {
  const wave = Math.sin(2 * Math.PI * share * share * (3 - 2 * share)); // slow at both ends
  return wave > 0 ? wave * right : -wave * left;
}
