/**
 * An immersive WebXR session. Both eyes draw one order of splats, sorted for the middle of the head.
 *
 * XR space has x right, y up, z backward; here as everywhere x right, y down, z forward, so y and z change sign.
 */

import { add, cross, dot, row, unit } from "../lib/vectors.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */
/** @typedef {import("./camera.js").Vec3} Vec3 */

const REACH = 2; // metres from the head to the centre of the page's orbit at first, which sets the scale
const PACE = 1.5; // metres a second with the left stick pushed
const SNAP = Math.PI / 6; // radians of a turn with the right stick
const DEAD = 0.2,
  PUSHED = 0.7; // shares of a stick's travel: less is ignored, more is a push

/** Where XR space lies in the scene. @typedef {{ axes: [Vec3, Vec3, Vec3], origin: Vec3, scale: number }} Stand */

/** The scene upright, seen from where the page's viewer is. @type {(stance: import("./stance.js").Stance) => Stand} */
function standing({ pose, up }) {
  const level = (/** @type {Vec3} */ v) => add(v, up, -dot(v, up));
  const ahead = level(row(pose.rotation, 2));
  const forward = unit(Math.hypot(...ahead) > 0.05 ? ahead : level(row(pose.rotation, 1)));
  const down = /** @type {Vec3} */ (up.map((x) => -x));
  return { axes: [cross(down, forward), down, forward], origin: pose.position, scale: pose.distance / REACH };
}

/** @type {(stand: Stand, v: Vec3) => Vec3} a direction of XR space in the scene */
const turned = ({ axes }, [x, y, z]) => add(add(add([0, 0, 0], axes[0], x), axes[1], -y), axes[2], -z);

/**
 * Camera centre and world-to-camera rows of a transform of XR space.
 * @type {(stand: Stand, transform: XRRigidTransform) => { position: Vec3, rotation: number[] }}
 */
function placed(stand, { matrix: m }) {
  const position = add(stand.origin, turned(stand, [m[12], m[13], m[14]]), stand.scale);
  const rows = [
    turned(stand, [m[0], m[1], m[2]]),
    turned(stand, [-m[4], -m[5], -m[6]]),
    turned(stand, [-m[8], -m[9], -m[10]]),
  ];
  return { position, rotation: rows.flat() };
}

/**
 * What the renderer needs for one eye.
 * @type {(stand: Stand, eye: XRView, width: number, height: number) => import("./surface.js").View}
 */
function seen(stand, { transform, projectionMatrix: p }, width, height) {
  const { position, rotation } = placed(stand, transform);
  const translation = [0, 1, 2].map((i) => -dot(row(rotation, i), position));
  return {
    rotation,
    translation,
    focal: [(p[0] * width) / 2, (p[5] * height) / 2],
    principal: [(width / 2) * (1 - p[8]), (height / 2) * (1 + p[9])],
  };
}

/**
 * Must follow a click or a key.
 * @param {Viewer} viewer
 * @param {"immersive-vr" | "immersive-ar"} mode
 * @returns {Promise<XRSession>}
 */
export async function enter(viewer, mode) {
  viewer.painter.fallBack(); // headsets take pictures of WebGL2
  const renderer = /** @type {import("./renderer.js").Renderer} */ (viewer.painter.renderer),
    isSeeThrough = mode === "immersive-ar";
  const session = await /** @type {XRSystem} */ (navigator.xr).requestSession(mode);
  await renderer.gl.makeXRCompatible();
  const layer = new XRWebGLLayer(session, renderer.gl, { antialias: false, depth: false, alpha: isSeeThrough });
  await session.updateRenderState({ baseLayer: layer });
  const space = await session.requestReferenceSpace("local");
  let stand = standing(viewer.stance),
    before = 0,
    turning = false;

  /** Sticks: left walks, right turns about the head. @type {(head: XRRigidTransform, seconds: number) => void} */
  const walk = (head, seconds) => {
    for (const { gamepad, handedness } of session.inputSources) {
      const [x, y] = [gamepad?.axes[2] ?? 0, gamepad?.axes[3] ?? 0];
      const { position, rotation } = placed(stand, head);
      if (handedness === "right") {
        if (Math.abs(x) > PUSHED && !turning) {
          const angle = Math.sign(x) * SNAP,
            [right, down, forward] = stand.axes;
          const ahead = unit(add(add([0, 0, 0], forward, Math.cos(angle)), right, Math.sin(angle)));
          stand = { ...stand, axes: [cross(down, ahead), down, ahead] };
          stand.origin = add(stand.origin, add(position, placed(stand, head).position, -1));
        }
        turning = Math.abs(x) > PUSHED;
      } else if (Math.hypot(x, y) > DEAD) {
        const step = PACE * stand.scale * seconds;
        stand = { ...stand, origin: add(add(stand.origin, row(rotation, 0), x * step), row(rotation, 2), -y * step) };
      }
    }
  };
  /** @type {XRFrameRequestCallback} */
  const frame = (time, now) => {
    session.requestAnimationFrame(frame);
    const pose = now.getViewerPose(space);
    if (!pose) return;
    walk(pose.transform, Math.min((time - (before || time)) / 1000, 0.1));
    before = time;
    viewer.lookFrom(placed(stand, pose.transform));
    for (const eye of pose.views) {
      const port = layer.getViewport(eye);
      if (!port) continue;
      const { x, y, width, height } = port;
      renderer.draw(seen(stand, eye, width, height), {
        framebuffer: layer.framebuffer,
        x,
        y,
        width,
        height,
        isSeeThrough,
      });
    }
  };
  viewer.presenting = true;
  session.addEventListener("end", () => {
    viewer.presenting = false;
    viewer.viewChanged();
  });
  session.requestAnimationFrame(frame);
  return session;
}
