/** Hands on the camera: mouse, trackpad, touch, keyboard and gamepad turned into poses. */

import { add, unit } from "../lib/vectors.js";
import { fly, focusOn, look, orbit, pan, zoom } from "./camera.js";
import { spread } from "./limits.js";

/** @typedef {import("./camera.js").Vec3} Vec3 */

const MAX_TURN = 3.2,
  MIN_TURN = 0.8; // radians for a drag across the picture's height
const INSIDE = 0.15; // as far outside of what the rig has seen a drag may end
const NEAREST = 0.08; // of the distance at home: closer one would be inside of things
const WHEEL = 0.0012,
  DOUBLE_TAP_MS = 320,
  TAP_PX = 8;
const WALK = 0.6; // of the distance to the target, a second
const GLIDE = 6; // per second, how fast inertia fades
const SWAY = 0.14,
  SWAY_PERIOD_S = 24,
  SWAY_AFTER_S = 8; // radians to each side; of one swing; idle before

/** Flying keys by physical place, so that they work on every layout. @type {Record<string, Vec3>} */
const FLY = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, 1, 0], KeyE: [0, -1, 0] };
/** @type {Record<string, [number, number]>} */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

export class Controls {
  /** @param {import("./viewer.js").Viewer} viewer */
  constructor(viewer) {
    this.viewer = viewer;
    /** @type {Map<number, { x: number, y: number }>} fingers and buttons down */
    this.pointers = new Map();
    /** @type {Set<string>} */
    this.keys = new Set();
    this.shift = false;
    this.panning = false;
    this.spin = { yaw: 0, pitch: 0 }; // radians a second, after letting go
    this.last = 0;
    this.idleSince = 0;
    this.tap = { time: 0, x: 0, y: 0 };
    this.travel = 0;
    /** @type {import("./camera.js").Pose | null} the last one that the rig has seen well */
    this.inside = null;
    this.mayDrift = () => true; // whether the picture may move by itself
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    // In a frame of another page the wheel scrolls that page until somebody clicks the picture.
    this.engaged = window.parent === window;
    this.abort = new AbortController();
    const { canvas } = viewer,
      { signal } = this.abort;
    /** @type {(name: string, handler: (event: any) => void, target?: EventTarget) => void} */
    const on = (name, handler, target = canvas) => target.addEventListener(name, handler, { signal, passive: false });
    on("pointerdown", (event) => this.#down(event));
    on("pointermove", (event) => this.#move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) on(name, (event) => this.#up(event));
    on("wheel", (event) => this.#wheel(event));
    on("contextmenu", (event) => event.preventDefault());
    on("dblclick", (event) => this.focus(event.clientX, event.clientY));
    on("keydown", (event) => this.#key(event, true), window);
    on("keyup", (event) => this.#key(event, false), window);
    on(
      "blur",
      () => {
        this.keys.clear();
        this.#engage(window.parent === window);
      },
      window,
    );
    on("frame", (event) => this.#frame(event.detail.now), viewer);
  }

  destroy() {
    this.abort.abort();
  }

  /** @param {boolean} on */
  #engage(on) {
    this.engaged = on;
    document.body.classList.toggle("engaged", on);
  }

  /** Radians for a drag across the picture's height: across the rig, and a little more. */
  get #turn() {
    const { space } = this.viewer.stance;
    return space ? Math.min(Math.max(2.6 * spread(space), MIN_TURN), MAX_TURN) : MAX_TURN;
  }

  /** Closer or farther, as far as things allow. @param {number} factor */
  #zoom(factor) {
    const { pose, home } = this.viewer.stance,
      nearest = Math.min(NEAREST * (home?.distance ?? 0), pose.distance);
    return zoom(pose, Math.max(factor, nearest / pose.distance));
  }

  get #height() {
    return this.viewer.canvas.clientHeight || 1;
  }

  /** @param {PointerEvent} event */
  #down(event) {
    this.#engage(true);
    this.viewer.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.panning = event.button === 2 || event.button === 1 || event.shiftKey;
    this.spin = { yaw: 0, pitch: 0 };
    this.viewer.touched = true;
    if (this.pointers.size === 1) this.travel = 0;
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const h = this.#height,
      dx = (now.x - before.x) / h,
      dy = (now.y - before.y) / h;
    this.travel += Math.hypot(now.x - before.x, now.y - before.y);
    const { stance } = this.viewer,
      turn = this.#turn;
    if (this.pointers.size >= 2) {
      const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, point]) => point);
      const was = Math.hypot(before.x - others[0].x, before.y - others[0].y);
      const is = Math.hypot(now.x - others[0].x, now.y - others[0].y);
      stance.steer(pan(this.#zoom(was / Math.max(is, 1)), -dx / 2, -dy / 2));
    } else if (this.panning) {
      stance.steer(pan(stance.pose, -dx, -dy));
    } else {
      stance.steer(orbit(stance.pose, stance.up, -dx * turn, dy * turn));
      const seconds = Math.max(event.timeStamp - this.last, 4) / 1000;
      const mix = Math.min(1, seconds * 20);
      this.spin.yaw += ((-dx * turn) / seconds - this.spin.yaw) * mix;
      this.spin.pitch += ((dy * turn) / seconds - this.spin.pitch) * mix;
    }
    this.last = event.timeStamp;
    this.pointers.set(event.pointerId, now);
  }

  /** @param {PointerEvent} event */
  #up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    this.viewer.touched = this.pointers.size > 0;
    if (!this.pointers.size && this.inside && this.viewer.stance.outside > INSIDE) {
      this.viewer.stance.moveTo(this.inside); // as if held by a rubber band
      this.last = 0; // without inertia
    }
    if (this.panning || this.pointers.size || event.timeStamp - this.last > 60) this.spin = { yaw: 0, pitch: 0 };
    if (event.pointerType !== "touch" || event.type !== "pointerup" || this.travel > TAP_PX) return;
    const again = event.timeStamp - this.tap.time < DOUBLE_TAP_MS;
    if (again && Math.hypot(event.clientX - this.tap.x, event.clientY - this.tap.y) < 4 * TAP_PX)
      this.focus(event.clientX, event.clientY);
    this.tap = { time: again ? 0 : event.timeStamp, x: event.clientX, y: event.clientY };
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    if (!this.engaged) return;
    event.preventDefault();
    const { stance } = this.viewer,
      h = this.#height;
    const unitOf = event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? h : 1;
    if (event.shiftKey) stance.steer(pan(stance.pose, (event.deltaX * unitOf) / h, (event.deltaY * unitOf) / h));
    else
      stance.steer(
        this.#zoom(Math.exp(Math.min(Math.max(event.deltaY * unitOf * (event.ctrlKey ? 8 : 1), -400), 400) * WHEEL)),
      );
  }

  /**
   * Turn to the surface under a point of the page and orbit around it.
   * @param {number} clientX
   * @param {number} clientY
   */
  async focus(clientX, clientY) {
    const { viewer } = this,
      { canvas, stance } = viewer;
    const box = canvas.getBoundingClientRect();
    const { focal, principal, rotation: r } = viewer.view();
    const u = (((clientX - box.left) / box.width) * canvas.width - principal[0]) / focal[0];
    const v = (((clientY - box.top) / box.height) * canvas.height - principal[1]) / focal[1];
    const direction = unit([r[0] * u + r[3] * v + r[6], r[1] * u + r[4] * v + r[7], r[2] * u + r[5] * v + r[8]]);
    const point = await viewer.ask("pick", stance.pose.position, direction);
    if (!point) return;
    stance.posed = true;
    const turned = focusOn(stance.pose, point, stance.up);
    const distance = turned.distance * 0.75;
    stance.moveTo({
      ...turned,
      distance,
      position: add(point, /** @type {Vec3} */ (turned.rotation.slice(6, 9)), -distance),
    });
  }

  /** @param {KeyboardEvent} event @param {boolean} down */
  #key(event, down) {
    this.shift = event.shiftKey;
    if (!down) {
      this.keys.delete(event.code);
      return;
    }
    const target = /** @type {HTMLElement} */ (event.target);
    if (
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      target.closest?.("dialog, .menu") ||
      (event.code in ARROWS && target.closest?.("input"))
    )
      return;
    if (["+", "=", "-"].includes(event.key)) {
      this.viewer.stance.steer(this.#zoom(event.key === "-" ? 1.12 : 1 / 1.12));
      this.keys.clear();
    } else if (event.code in FLY || event.code in ARROWS) this.keys.add(event.code);
    else return;
    event.preventDefault();
  }

  /** A slow swing around the target while nobody touches anything. @param {number} now @param {number} seconds */
  #sway(now, seconds) {
    const { presenting, stance } = this.viewer,
      isIdle = document.body.classList.contains("idle");
    if (
      !isIdle ||
      !this.mayDrift() ||
      this.still.matches ||
      presenting ||
      stance.glide ||
      document.body.classList.contains("still")
    )
      this.idleSince = 0;
    else this.idleSince ||= now;
    const idle = this.idleSince ? (now - this.idleSince) / 1000 - SWAY_AFTER_S : 0;
    if (idle <= 0) return;
    const rate =
      SWAY * Math.cos((2 * Math.PI * idle) / SWAY_PERIOD_S) * ((2 * Math.PI) / SWAY_PERIOD_S) * Math.min(1, idle / 4);
    stance.drift(orbit(stance.pose, stance.up, rate * seconds, 0));
  }

  /** @param {number} now */
  #frame(now) {
    const { stance } = this.viewer;
    if (stance.outside <= INSIDE && !stance.glide) this.inside = stance.pose;
    const seconds = Math.min((now - (this.before ?? now)) / 1000, 0.1);
    this.before = now;
    /** @type {Vec3} */
    let walk = [0, 0, 0];
    let yaw = 0,
      pitch = 0;
    for (const code of this.keys) {
      if (FLY[code]) walk = add(walk, FLY[code]);
      const arrow = ARROWS[code];
      if (arrow && this.shift) walk = add(walk, [arrow[0], -arrow[1], 0], 0.6);
      else if (arrow) [yaw, pitch] = [yaw + arrow[0], pitch + arrow[1]];
    }
    const pad = [...(navigator.getGamepads?.() ?? [])].find((gamepad) => gamepad?.connected);
    if (pad) {
      const axes = [0, 1, 2, 3].map((i) => (Math.abs(pad.axes[i] ?? 0) > 0.15 ? pad.axes[i] : 0));
      walk = add(walk, [axes[0], (pad.buttons[6]?.value ?? 0) - (pad.buttons[7]?.value ?? 0), -axes[1]]);
      if (axes[2] || axes[3])
        stance.steer(look(stance.pose, stance.up, axes[2] * 1.8 * seconds, -axes[3] * 1.8 * seconds));
    }
    if (walk.some((x) => x !== 0)) {
      const pace = WALK * stance.pose.distance * seconds * (this.shift ? 2.5 : 1);
      stance.steer(fly(stance.pose, [walk[0] * pace, walk[1] * pace, walk[2] * pace]));
    }
    if (yaw || pitch) stance.steer(orbit(stance.pose, stance.up, yaw * 1.4 * seconds, pitch * 1.1 * seconds));
    this.#sway(now, seconds);
    if (!this.pointers.size && !this.still.matches && Math.hypot(this.spin.yaw, this.spin.pitch) > 0.02) {
      stance.steer(orbit(stance.pose, stance.up, this.spin.yaw * seconds, this.spin.pitch * seconds));
      const fade = Math.exp(-GLIDE * seconds);
      this.spin = { yaw: this.spin.yaw * fade, pitch: this.spin.pitch * fade };
    }
  }
}
