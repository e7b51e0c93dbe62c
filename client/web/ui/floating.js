/**
 * The picture in a small window that stays above others, also while the page's tab is hidden (Document
 * Picture-in-Picture). It draws by that window's clock, as browsers stop that of hidden tabs.
 */

/** @typedef {Window & typeof globalThis} Pane */

const STYLE =
  "body { margin: 0; overflow: hidden; background: #000 } canvas { position: absolute; width: 100%; height: 100%; display: block; touch-action: none }";
const WIDTH = 480; // pixels, at first

/**
 * Move the picture to a window of its own until that is closed; closes it where there is one.
 * @param {import("../view/viewer.js").Viewer} viewer
 * @param {(floats: boolean) => void} tell
 */
export async function toggleFloating(viewer, tell) {
  const { documentPictureInPicture: panes } = /** @type {any} */ (window),
    { canvas } = viewer;
  if (panes.window) return panes.window.close();
  const height = Math.round((WIDTH * canvas.clientHeight) / canvas.clientWidth);
  const pane = /** @type {Pane} */ (await panes.requestWindow({ width: WIDTH, height }));
  pane.document.head.append(Object.assign(pane.document.createElement("style"), { textContent: STYLE }));
  pane.document.title = document.title;
  const parts = [...new Set([viewer.painter.renderer.canvas, canvas])],
    place = document.createComment("");
  canvas.after(place);
  pane.document.body.append(...parts);
  pane.addEventListener("resize", () => viewer.resize());
  pane.addEventListener("keydown", (event) => {
    if (
      !document.body.dispatchEvent(
        new KeyboardEvent("keydown", { key: event.key, shiftKey: event.shiftKey, bubbles: true, cancelable: true }),
      )
    )
      event.preventDefault();
  });
  pane.addEventListener("pagehide", () => {
    place.replaceWith(...parts);
    viewer.runIn(window);
    tell(false);
  });
  viewer.runIn(pane);
  tell(true);
}
