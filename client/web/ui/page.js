/** Small helpers for the page's elements. */

/** @type {(id: string) => HTMLElement} the element must exist */
export function element(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found;
}

/** @type {(id: string) => HTMLButtonElement} */
export const button = (id) => /** @type {HTMLButtonElement} */ (element(id));

/** @type {(id: string, icon: string) => void} show another icon on a button */
export const setIcon = (id, icon) => element(id).querySelector("use")?.setAttribute("href", `#i-${icon}`);

let toastTimer = 0;
/** A line that goes away by itself. @type {(text: string, ms?: number) => void} */
export function toast(text, ms = 2600) {
  const line = element("toast");
  line.textContent = text;
  line.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (line.hidden = true), ms);
}

/** A menu under a button: opens, closes, moves by arrow keys. @type {(button: HTMLElement, menu: HTMLElement, fill: () => void) => void} */
export function attachMenu(opener, menu, fill) {
  const close = () => {
    menu.hidden = true;
    opener.setAttribute("aria-expanded", "false");
  };
  opener.addEventListener("click", () => {
    const open = menu.hidden;
    for (const other of document.querySelectorAll(".menu")) /** @type {HTMLElement} */ (other).hidden = true;
    if (!open) return close();
    fill();
    menu.hidden = false;
    opener.setAttribute("aria-expanded", "true");
    menu.querySelector("button")?.focus();
  });
  menu.addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      close();
      opener.focus();
    }
    const step = event.key === "ArrowDown" ? 1 : event.key === "ArrowUp" ? -1 : 0;
    if (!step) return;
    event.preventDefault();
    const items = [...menu.querySelectorAll("button")];
    const at = items.indexOf(/** @type {HTMLButtonElement} */ (document.activeElement));
    items[(at + step + items.length) % items.length]?.focus();
  });
  document.addEventListener("pointerdown", ({ target }) => {
    const inside = menu.contains(/** @type {Node} */ (target)) || opener.contains(/** @type {Node} */ (target));
    if (!menu.hidden && !inside) close();
  });
}

/** @type {(label: string, note: string, checked: boolean | null, act: () => void) => HTMLButtonElement} */
export function menuItem(label, note, checked, act) {
  const item = document.createElement("button");
  item.append(label);
  if (note) item.append(Object.assign(document.createElement("small"), { textContent: note }));
  if (checked !== null) item.setAttribute("aria-pressed", String(checked));
  item.addEventListener("click", act);
  return item;
}
