/** What phones need: tools as a sheet from below, a hint about gestures, help without keys, a screen that stays on. */

import { button, element, toast } from "./page.js";
import { MOVING } from "./timeline.js";

const HINT = "Drag to look around, pinch to come closer, two fingers to move",
  HINT_MS = 5000;
const AFTER_WARNING_MS = 6000; // the page says first that it draws in software

/** @param {import("../view/viewer.js").Viewer} viewer */
export function attachPhone(viewer) {
  attachWhole(viewer);
  const { classList } = document.body,
    more = button("b-more");
  /** @param {boolean} open */
  const sheet = (open) => {
    classList.toggle("sheet", open);
    more.setAttribute("aria-expanded", String(open));
  };
  more.onclick = () => sheet(!classList.contains("sheet"));
  viewer.canvas.addEventListener("pointerdown", () => sheet(false));
  element("tools").addEventListener("click", ({ target }) => {
    // what it does is seen where the sheet lies; only menus lie above it
    if (!(/** @type {Element} */ (target).closest("[aria-haspopup]"))) sheet(false);
  });

  /** Help speaks of the input that was used last. @param {boolean} touch */
  const use = (touch) => classList.toggle("touch", touch);
  use(matchMedia("(pointer: coarse)").matches);
  window.addEventListener("pointerdown", ({ pointerType }) => use(pointerType === "touch"));
  window.addEventListener("keydown", () => use(false));
  const hint = () => classList.contains("touch") && toast(HINT, HINT_MS);
  viewer.addEventListener("picture", () => setTimeout(hint, viewer.painter.software ? AFTER_WARNING_MS : 0), {
    once: true,
  });

  /** @type {WakeLockSentinel | null} */
  let lock = null;
  let asking = false;
  /** The screen stays on while something plays. */
  const stayOn = async () => {
    const wanted =
      [...MOVING, "preview"].includes(viewer.status?.phase ?? "") && document.visibilityState === "visible";
    if (!wanted) {
      lock?.release();
      lock = null;
    } else if (!asking && (!lock || lock.released) && "wakeLock" in navigator) {
      asking = true;
      lock = await navigator.wakeLock.request("screen").catch(() => null); // may be refused
      asking = false;
    }
  };
  let phase = "";
  viewer.addEventListener("status", () => {
    if (viewer.status?.phase === phase) return;
    phase = viewer.status?.phase ?? "";
    stayOn();
  });
  document.addEventListener("visibilitychange", stayOn);
}

/**
 * On a narrow screen, the button between a cut picture and a whole one.
 * @param {import("../view/viewer.js").Viewer} viewer
 */
function attachWhole(viewer) {
  const whole = button("b-whole");
  const update = () => (whole.hidden = !viewer.isNarrow);
  viewer.addEventListener("scene", update);
  window.addEventListener("resize", update);
  whole.onclick = () => {
    viewer.showWhole(!viewer.whole);
    whole.setAttribute("aria-pressed", String(viewer.whole));
  };
}
