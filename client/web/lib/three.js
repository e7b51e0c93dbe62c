/**
 * A stream in a scene of three.js, drawn by its own splats (r186 and newer, WebGPURenderer, also with `forceWebGL`).
 * docs/engines.md says more.
 *
 *     const splats = new StreamlodSplats();
 *     scene.add(splats);
 *     follow(await open(address), (frame) => splats.take(frame));
 *
 * three.js has no public way to change splats yet (its issue 34527): this one writes the buffers that r187 has, and says
 * so where another release has others.
 */

import { GaussianSplat } from "three/addons/objects/GaussianSplat.js";
import { Discard, Fn, dot, exp, varyingProperty, vec4 } from "three/tsl";
import { BufferAttribute, BufferGeometry, Group } from "three/webgpu";

/**
 * A splat's colour where it reaches 1/255, as streamlod draws it; three.js itself ends splats at two standard
 * deviations.
 */
const wholeSplat = Fn(() => {
  const offset = varyingProperty("vec2", "vSplatUv"),
    colour = varyingProperty("vec4", "vSplatColor");
  const alpha = exp(dot(offset, offset).mul(-0.5)).mul(colour.a).toVar();
  Discard(alpha.lessThan(1 / 255));
  return vec4(colour.rgb, alpha);
});
const REACH = Math.sqrt(2 * Math.log(255)); // standard deviations

/** @typedef {import("three/webgpu").BufferAttribute & { pbo?: { needsUpdate: boolean } }} Buffer - `pbo`: its twin under WebGL */

/** Splats with room for `count`, all of them empty. @param {number} count */
function roomFor(count) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * count), 3));
  geometry.setAttribute("covariance", new BufferAttribute(new Float32Array(6 * count), 6));
  geometry.setAttribute("color", new BufferAttribute(new Uint8Array(4 * count), 4, true));
  const splats = new GaussianSplat(geometry),
    buffers = /** @type {any} */ (splats)._buffers ?? {};
  /** @type {Buffer[]} centre, covariance xx xy xz yy, covariance yz zz, colour */
  const attributes = ["centerRead", "covarianceARead", "covarianceBRead", "colorRead"].map(
    (name) => buffers[name]?.value,
  );
  if (!attributes.every((attribute) => attribute?.array))
    throw new Error("this release of three.js keeps its splats elsewhere: use r187");
  splats.frustumCulled = false;
  splats.material.colorNode = wholeSplat();
  splats.geometry.scale(REACH / 2, REACH / 2, 1);
  return {
    splats,
    attributes,
    count,
    position: geometry.getAttribute("position").array,
    covariance: geometry.getAttribute("covariance").array,
  };
}

/** @type {(x: number) => number} */
const byte = (x) => Math.round(255 * x);

export class StreamlodSplats extends Group {
  constructor() {
    super();
    /** @type {ReturnType<typeof roomFor> | null} */
    this.room = null;
  }

  /** Rewrite what changed. @param {import("./frame.js").Frame} frame */
  take({ count, positions, covariances, opacities, colors, changes, isNew }) {
    if (!this.room || this.room.count < count) {
      this.dispose();
      this.room = roomFor(Math.ceil(1.25 * count));
      this.add(this.room.splats);
      [changes, isNew] = [[{ first: 0, count }], true];
    }
    const { splats, attributes, position, covariance } = this.room,
      [centres, upper, lower, words] = attributes.map(({ array }) => array);
    for (const { first, count: length } of changes) {
      position.set(positions.subarray(3 * first, 3 * (first + length)), 3 * first);
      covariance.set(covariances.subarray(6 * first, 6 * (first + length)), 6 * first);
      for (let i = first; i < first + length; i++) {
        centres.set(positions.subarray(3 * i, 3 * i + 3), 4 * i);
        upper.set(covariances.subarray(6 * i, 6 * i + 4), 4 * i);
        lower.set(covariances.subarray(6 * i + 4, 6 * i + 6), 4 * i);
        words[i] =
          (byte(opacities[i]) << 24) |
          (byte(colors[3 * i + 2]) << 16) |
          (byte(colors[3 * i + 1]) << 8) |
          byte(colors[3 * i]);
      }
    }
    if (isNew) {
      words.fill(0, count);
      splats.computeBoundingSphere(); // the range of depths that is sorted
    }
    for (const attribute of attributes) {
      attribute.needsUpdate = true;
      if (attribute.pbo) attribute.pbo.needsUpdate = true;
    }
    /** @type {any} */ (splats)._sortInitialized = false;
  }

  /** Free the graphics card's buffers. */
  dispose() {
    this.room?.splats.removeFromParent();
    this.room?.splats.geometry.dispose();
    this.room?.splats.material.dispose();
    this.room = null;
  }
}
