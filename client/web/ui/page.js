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

/**
 * Keep what is chosen in the page's address; null: as usual, which is left out.
 * @param {string} name
 * @param {string | null} text
 */
export function keepInAddress(name, text) {
  const address = new URL(location.href);
  if (text) address.searchParams.set(name, text);
  else address.searchParams.delete(name);
  history.replaceState(history.state, "", address);
}

let toastTimer = 0;
/**
 * A line that goes away by itself, with a button where there is something to do about it.
 * @type {(text: string, ms?: number, offer?: { label: string, act: () => void } | null) => void}
 */
export function toast(text, ms = 2600, offer = null) {
  const line = element("toast"),
    way = button("toast-button");
  element("toast-text").textContent = text;
  way.hidden = !offer;
  way.textContent = offer?.label ?? "";
  way.onclick = () => {
    line.hidden = true;
    offer?.act();
  };
  line.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (line.hidden = true), ms);
}

/** @type {(() => void) | null} */
let closeOpenMenu = null;

/**
 * A menu under a button: opens, closes, also when the focus leaves, and moves by arrow keys.
 * @type {(button: HTMLElement, menu: HTMLElement, fill: () => void) => void}
 */
export function attachMenu(opener, menu, fill) {
  const close = () => {
    menu.hidden = true;
    opener.setAttribute("aria-expanded", "false");
    if (closeOpenMenu === close) closeOpenMenu = null;
  };
  opener.addEventListener("click", () => {
    const open = menu.hidden;
    closeOpenMenu?.();
    if (!open) return;
    closeOpenMenu = close;
    fill();
    menu.hidden = false;
    opener.setAttribute("aria-expanded", "true");
    menu.querySelector("button")?.focus();
  });
  menu.addEventListener("focusout", ({ relatedTarget: to }) => {
    if (to && !menu.contains(/** @type {Node} */ (to)) && to !== opener) close();
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
