/**
 * Exposure of a picture by viewpoint: as a camera filmed where it stood, neutral away from all cameras
 * (core/scene/exposures.py).
 */

import { distanceTo, fromCamera } from "./camera.js";

/** Gain r g b and offset r g b: a picture is gain * neutral + offset. @typedef {number[]} Exposure */
/** @typedef {import("./camera.js").Vec3} Vec3 */
/** @typedef {import("../decode/scene.js").RigCamera} RigCamera */

/** @type {Exposure} */
export const NEUTRAL = [1, 1, 1, 0, 0, 0];

/**
 * The exposure of a picture that is taken from `centre`: a camera's own at the camera, blended on the way to its nearest
 * neighbour, neutral where every camera is farther away than its nearest neighbour is.
 * @param {Vec3} centre
 * @param {RigCamera[]} cameras
 * @param {Exposure[] | undefined} exposures - of the cameras
 * @returns {Exposure}
 */
export function exposureAt(centre, cameras, exposures) {
  if (!exposures?.length || exposures.length !== cameras.length) return NEUTRAL;
  const weights = cameras.map((camera, i) => nearness(distanceTo(centre, camera), reachOf(cameras, i)));
  const total = weights.reduce((sum, weight) => sum + weight, 0),
    rest = Math.max(1 - total, 0);
  return NEUTRAL.map(
    (neutral, k) =>
      (exposures.reduce((sum, exposure, i) => sum + weights[i] * exposure[k], 0) + rest * neutral) / (total + rest),
  );
}

/** Distance to the nearest other camera. @type {(cameras: RigCamera[], number: number) => number} */
const reachOf = (cameras, number) =>
  Math.min(
    ...cameras
      .filter((_, i) => i !== number)
      .map((other) => distanceTo(fromCamera(cameras[number], 1).position, other)),
  );

/**
 * 1 at a camera to 0 at `reach`; one camera alone reaches everywhere.
 * @type {(away: number, reach: number) => number}
 */
function nearness(away, reach) {
  const share = reach === Infinity || away === 0 ? 1 : reach === 0 ? 0 : Math.min(Math.max(1 - away / reach, 0), 1);
  return share * share * (3 - 2 * share);
}
