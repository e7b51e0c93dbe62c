/** The page that shows what all cameras of a live stream see, while `streamlod rig` runs (docs/filming.md). */

import { element } from "./page.js";

const PICTURES_MS = 400,
  FIGURES_MS = 1000;
const EMPTY = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="; // else a browser draws a broken one

/** @typedef {{ state: string, trouble: string, rate: number | null, size: [number, number] | null }} Figures of a camera; docs/ingest.md */

const options = new URLSearchParams(location.search);
const place = new URL(`v1/streams/${encodeURIComponent(options.get("stream") ?? "main")}`, new URL(".", location.href))
  .href;
const token = options.get("token"),
  headers = new Headers(token ? { Authorization: `Bearer ${token}` } : {});

/** A camera on the page. */
class Tile {
  /** @param {string} name */
  constructor(name) {
    this.name = name;
    this.item = document.createElement("li");
    this.image = Object.assign(document.createElement("img"), { alt: `What ${name} sees`, src: EMPTY });
    this.facts = document.createElement("p");
    this.trouble = Object.assign(document.createElement("p"), { className: "trouble" });
    this.item.append(
      this.image,
      Object.assign(document.createElement("h2"), { textContent: name }),
      this.facts,
      this.trouble,
    );
  }

  /** @param {Figures} figures */
  tell({ state, trouble, rate, size }) {
    const pace = rate === null || state === "lost" ? "" : `${Math.round(rate)} a second`;
    if (size) this.image.style.aspectRatio = size.join("/");
    this.facts.textContent = [size?.join("×"), pace].filter(Boolean).join(" · ");
    if (this.trouble.textContent !== trouble) this.trouble.textContent = trouble;
    this.item.classList.toggle("bad", trouble !== "");
  }

  /** Show the newest picture, where there is one. */
  async look() {
    const answer = await fetch(`${place}/cameras/${encodeURIComponent(this.name)}.jpg`, { headers }).catch(() => null);
    const picture = answer?.ok ? await answer.blob().catch(() => null) : null;
    if (!picture) return;
    const before = this.image.src;
    this.image.src = URL.createObjectURL(picture);
    await this.image.decode().catch(() => {}); // else it would blink
    URL.revokeObjectURL(before);
  }
}

/** @type {Map<string, Tile>} */
const tiles = new Map();
/** @type {string[]} of which there are pictures */
let seen = [];

/** @param {string} text @param {string} tone */
function say(text, tone) {
  const line = element("status-text");
  if (line.textContent !== text) line.textContent = text;
  document.body.dataset.tone = tone;
}

/** @param {{ ingest: { cameras: Record<string, Figures> } | null, camera_pictures: string[] }} stream */
function tell({ ingest, camera_pictures }) {
  const cameras = Object.entries(ingest?.cameras ?? {});
  seen = camera_pictures;
  for (const [name, figures] of cameras) {
    let tile = tiles.get(name);
    if (!tile) {
      tiles.set(name, (tile = new Tile(name)));
      element("cameras").append(tile.item);
    }
    tile.tell(figures);
  }
  const bad = cameras.filter(([, { trouble }]) => trouble).map(([name]) => name);
  const well = `${cameras.length - bad.length} of ${cameras.length} cameras film as they should`;
  if (!cameras.length) say("No camera films yet", "busy");
  else if (!bad.length) say(well, "good");
  else say(`${well}; see ${bad.join(", ")}`, "busy");
}

async function figures() {
  const answer = await fetch(place, { headers }).catch(() => null);
  if (answer?.ok) return tell(await answer.json());
  seen = [];
  if (!answer) say("The server does not answer; this page goes on by itself once it does", "bad");
  else
    say(
      answer.status === 404 ? "There is no such stream" : "This page needs the right to watch: open it with ?token=",
      "bad",
    );
}

/** Do something again and again while the page is looked at. @param {() => Promise<unknown>} act @param {number} ms */
async function again(act, ms) {
  for (;;) {
    if (!document.hidden) await act().catch(() => {});
    await new Promise((resolve) => setTimeout(resolve, ms));
  }
}

again(figures, FIGURES_MS);
again(() => Promise.all(seen.map((name) => tiles.get(name)?.look())), PICTURES_MS);
