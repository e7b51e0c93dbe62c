/** Depth of field: how blurred is what is nearer or farther than what is looked at. The address keeps it. */

import { keepInAddress } from "./page.js";

const STEPS = 100;

/** A share of the most blur. @type {(text: string | null) => number} 0 where it is no whole number up to 100 */
export const blurOf = (text) => (/^\d{1,3}$/.test(text ?? "") ? Math.min(Number(text), STEPS) / STEPS : 0);

/** What a menu shows of it. @param {import("../view/viewer.js").Viewer} viewer @returns {HTMLElement[]} */
export function lensItems(viewer) {
  const label = Object.assign(document.createElement("label"), { textContent: "Depth of field" });
  const field = Object.assign(document.createElement("input"), {
    type: "range",
    max: String(STEPS),
    value: String(STEPS * viewer.blur),
  });
  field.oninput = () => {
    keepInAddress("blur", field.value === "0" ? null : field.value);
    viewer.focus(blurOf(field.value));
  };
  label.append(field);
  return [label];
}
