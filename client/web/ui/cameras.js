/** The page that shows what all cameras of a live stream see, while `streamlod rig` runs (docs/filming.md). */

import { element } from "./page.js";

const PICTURES_MS = 400,
  FIGURES_MS = 1000;
const RATE_MS = 6000; // over which pictures are counted
const EMPTY = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw=="; // else a browser draws a broken one
/** What is wrong with a camera's times, by `time_fault` of docs/ingest.md. @type {Record<string, string>} */
const TIMES = {
  still: "its times stand still: restart it",
  back: "its times run backwards: restart it",
  far: "its times are far from those of the others: set its clock",
};

/** @typedef {{ state: string, fault: string, refused: string, time_fault: string | null, size: [number, number] | null, counts: { received: number } }} Figures of a camera; docs/ingest.md */

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
    /** @type {{ at: number, received: number }[]} */
    this.counted = [];
  }

  /** @param {Figures} figures @param {number} at - when they came, ms */
  tell({ state, fault, refused, time_fault, size, counts: { received } }, at) {
    this.counted = [
      ...this.counted.filter((one) => at - one.at <= RATE_MS && one.received <= received),
      { at, received },
    ];
    const [first] = this.counted,
      seconds = (at - first.at) / 1000;
    const rate = seconds > 0.9 ? `${Math.round((received - first.received) / seconds)} a second` : "";
    if (size) this.image.style.aspectRatio = size.join("/");
    this.facts.textContent = [size?.join("×"), state === "lost" ? "" : rate].filter(Boolean).join(" · ");
    const trouble = state === "lost" ? fault || "no pictures come" : refused || (TIMES[time_fault ?? ""] ?? "");
    if (this.trouble.textContent !== trouble) this.trouble.textContent = trouble;
    this.item.classList.toggle("bad", trouble !== "");
    return trouble === "";
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
  const cameras = Object.entries(ingest?.cameras ?? {}),
    now = performance.now();
  seen = camera_pictures;
  for (const [name] of cameras) {
    if (tiles.has(name)) continue;
    const tile = new Tile(name);
    tiles.set(name, tile);
    element("cameras").append(tile.item);
  }
  const well = cameras.filter(([name, figures]) => tiles.get(name)?.tell(figures, now)).length;
  if (!cameras.length) say("No camera films yet", "busy");
  else say(`${well} of ${cameras.length} cameras film as they should`, well === cameras.length ? "good" : "busy");
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
