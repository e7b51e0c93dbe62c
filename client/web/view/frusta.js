/** The rig's cameras as line drawings. */

import { add, fromCamera, row } from "./camera.js";

/**
 * @param {import("./camera.js").RigCamera[]} cameras
 * @param {number} depth - how far they reach, world units
 * @returns {Float32Array} 6 numbers a line
 */
export function frusta(cameras, depth) {
  /** @type {number[]} */
  const lines = [];
  for (const camera of cameras) {
    const { rotation, position } = fromCamera(camera, 1), k = camera.intrinsics;
    const corners = [[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]].map(([u, v]) => {
      const along = add(position, row(rotation, 2), depth);
      const across = add(along, row(rotation, 0), (depth * (u - k[2])) / k[0]);
      return add(across, row(rotation, 1), (depth * (v - k[5])) / k[4]);
    });
    corners.forEach((corner, i) => lines.push(...position, ...corner, ...corner, ...corners[(i + 1) % 4]));
  }
  return Float32Array.from(lines);
}
