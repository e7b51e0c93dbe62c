/** `node library.mjs ADDRESS SECONDS...`: frames of a file as the package gives them, one line of JSON each. */

import { decompose, open } from "../../../client/web/lib/streamlod.js";

const [address, ...times] = process.argv.slice(2);
const clip = await open(address);
for (const seconds of times.map(Number)) {
  const frame = await clip.frame(seconds);
  const shown = Array.from(frame.opacities.keys()).filter((i) => frame.opacities[i] > 0);
  let worst = 0; // of covariances that scales and rotations make again, as a share of their size
  for (const i of shown) {
    const scales = [0, 0, 0], q = [0, 0, 0, 0];
    decompose(frame.covariances, i, scales, q);
    const [x, y, z, w] = q;
    const r = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]];
    const again = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].map(([a, b]) => [0, 1, 2].reduce((sum, k) => sum + r[a][k] * r[b][k] * scales[k] ** 2, 0));
    const size = frame.covariances[6 * i] + frame.covariances[6 * i + 3] + frame.covariances[6 * i + 5];
    for (let k = 0; k < 6; k++) worst = Math.max(worst, Math.abs(again[k] - frame.covariances[6 * i + k]) / size);
  }
  const rows = (array, width) => shown.map((i) => Array.from(array.subarray(width * i, width * (i + 1))));
  console.log(JSON.stringify({
    version: frame.version, seconds: frame.seconds, isNew: frame.isNew, changed: frame.changes.reduce((sum, { count }) => sum + count, 0), count: frame.count, worst,
    positions: rows(frame.positions, 3), opacities: rows(frame.opacities, 1).flat(), covariances: rows(frame.covariances, 6), colors: rows(frame.colors, 3),
  }));
}
console.log(JSON.stringify({ duration: clip.duration, frames: clip.times.length, fps: clip.scene.fps, cameras: clip.scene.cameras.length }));
