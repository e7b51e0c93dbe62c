/** What is behind the scene: its own colour, or one that is chosen, which the address keeps. */

import { keepInAddress, menuItem } from "./page.js";

/** @typedef {import("../view/viewer.js").Viewer} Viewer */

/** @type {(text: string | null) => [number, number, number] | null} null where it is not six hexadecimal digits */
export function colourOf(text) {
  if (!/^[0-9a-f]{6}$/i.test(text ?? "")) return null;
  const number = parseInt(/** @type {string} */ (text), 16);
  return [(number >> 16) / 255, ((number >> 8) & 255) / 255, (number & 255) / 255];
}

/** @type {(colour: number[]) => string} */
const textOf = (colour) =>
  colour
    .map((x) =>
      Math.round(255 * x)
        .toString(16)
        .padStart(2, "0"),
    )
    .join("");

/** @param {Viewer} viewer @param {string | null} text */
function choose(viewer, text) {
  keepInAddress("background", text);
  viewer.paint(colourOf(text));
}

/** What a menu shows of it. @param {Viewer} viewer @returns {HTMLElement[]} */
export function backgroundItems(viewer) {
  const { painter } = viewer,
    label = Object.assign(document.createElement("label"), { textContent: "Background" });
  const field = Object.assign(document.createElement("input"), {
    type: "color",
    value: `#${textOf(painter.backdrop ?? painter.renderer.background)}`,
  });
  field.oninput = () => choose(viewer, field.value.slice(1));
  label.append(field);
  const own = menuItem("Background as filmed", "", painter.backdrop === null, () => {
    choose(viewer, null);
    field.value = `#${textOf(painter.backdrop ?? painter.renderer.background)}`;
    own.setAttribute("aria-pressed", "true");
  });
  field.addEventListener("input", () => own.setAttribute("aria-pressed", "false"));
  return [document.createElement("hr"), own, label];
}
