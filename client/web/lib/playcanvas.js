/**
 * A stream in a scene of PlayCanvas (2.23), drawn by its own splats. docs/engines.md says more.
 *
 *     const splats = new StreamlodSplats(app.graphicsDevice, entity);
 *     follow(await open(address), (frame) => splats.take(frame));
 */

import { BoundingBox, FloatPacking, GSplatContainer, GSplatFormat, Vec3, WORKBUFFER_UPDATE_ONCE } from "playcanvas";
import { decompose } from "./frame.js";

const STREAMS = ["dataCenter", "dataColor", "dataScale", "dataRotation"];
/** @type {(x: number) => number} */
const half = (x) => FloatPacking.float2Half(x);

export class StreamlodSplats {
  /**
   * @param {import("playcanvas").GraphicsDevice} device
   * @param {import("playcanvas").Entity} entity - gets a component `gsplat`
   */
  constructor(device, entity) {
    this.device = device;
    this.entity = entity;
    /** @type {GSplatContainer | null} */
    this.container = null;
  }

  /** Rewrite what changed. @param {import("./frame.js").Frame} frame */
  take({ count, positions, covariances, opacities, colors, changes, isNew }) {
    const old = this.container,
      isOutgrown = !old || old.maxSplats < count;
    const container = isOutgrown
      ? new GSplatContainer(this.device, Math.ceil(1.25 * count), GSplatFormat.createDefaultFormat(this.device))
      : old;
    const textures = STREAMS.map((name) => /** @type {import("playcanvas").Texture} */ (container.getTexture(name)));
    const [centres, rgba, sizes, turns] = textures.map(
      (texture) => /** @type {Float32Array | Uint16Array} */ (texture.lock()),
    );
    const scales = [0, 0, 0],
      rotation = [0, 0, 0, 1];
    for (const { first, count: length } of isOutgrown ? [{ first: 0, count }] : changes) {
      container.centers.set(positions.subarray(3 * first, 3 * (first + length)), 3 * first);
      for (let i = first; i < first + length; i++) {
        if (opacities[i] > 0) decompose(covariances, i, scales, rotation);
        for (let k = 0; k < 3; k++) {
          centres[4 * i + k] = positions[3 * i + k];
          rgba[4 * i + k] = half(colors[3 * i + k]);
          sizes[4 * i + k] = half(scales[k]);
        }
        rgba[4 * i + 3] = half(opacities[i]);
        for (let k = 0; k < 4; k++) turns[4 * i + k] = half(rotation[k]);
      }
    }
    for (const texture of textures) texture.unlock();
    if (isNew || isOutgrown) container.aabb = boxOf(positions, opacities);
    container.update(count);
    const gsplat =
      this.entity.gsplat ??
      /** @type {import("playcanvas").GSplatComponent} */ (this.entity.addComponent("gsplat", { resource: container }));
    if (isOutgrown) gsplat.resource = container;
    gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
    if (isOutgrown) old?.destroy();
    this.container = container;
  }

  destroy() {
    this.entity.removeComponent("gsplat");
    this.container?.destroy();
  }
}

/** Around all that is not empty. @param {Float32Array} positions @param {Float32Array} opacities */
function boxOf(positions, opacities) {
  const least = [Infinity, Infinity, Infinity],
    most = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i++) {
    if (!opacities[Math.trunc(i / 3)]) continue;
    least[i % 3] = Math.min(least[i % 3], positions[i]);
    most[i % 3] = Math.max(most[i % 3], positions[i]);
  }
  const box = new BoundingBox();
  if (least[0] <= most[0]) {
    box.setMinMax(new Vec3(least), new Vec3(most));
  }
  return box;
}
