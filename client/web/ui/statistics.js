/** Numbers for those who want them. */

const SPAN_MS = 3000;

/** Frames of the stream and their times. */
export class Rates {
  constructor() {
    /** @type {{ at: number, version: number, bytes: number }[]} */
    this.seen = [];
  }

  /** @param {import("../view/messages.js").PictureMessage} picture @param {number} bytes - received so far */
  frame({ version }, bytes) {
    const at = performance.now();
    if (this.seen[this.seen.length - 1]?.version === version) return;
    this.seen.push({ at, version, bytes });
    while (this.seen.length > 2 && at - this.seen[0].at > SPAN_MS) this.seen.shift();
  }

  /** Frames a second and kilobits a second. */
  now() {
    const first = this.seen[0],
      last = this.seen[this.seen.length - 1];
    const stale = !last || performance.now() - last.at > SPAN_MS || last.at - first.at < 200;
    if (stale) return { fps: 0, kilobits: 0 };
    const seconds = (last.at - first.at) / 1000;
    return { fps: (this.seen.length - 1) / seconds, kilobits: (8 * (last.bytes - first.bytes)) / 1000 / seconds };
  }
}

/**
 * @param {HTMLElement} list
 * @param {import("../view/viewer.js").Viewer} viewer
 * @param {Rates} rates
 * @param {number | null} delaySeconds - from camera to screen
 */
export function fillStatistics(list, viewer, rates, delaySeconds) {
  const {
    picture,
    status,
    canvas,
    painter: { renderer },
  } = viewer;
  const { fps, kilobits } = rates.now();
  /** @type {(value: number | undefined, unit: string, digits?: number) => string} */
  const number = (value, unit, digits = 1) => (value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`);
  const version = picture?.version,
    live = status?.source !== "recording";
  const rows = {
    Drawing: number(viewer.pace.fps, "fps", 0),
    Stream: number(fps, "fps"),
    Data: number(kilobits / 1000, "Mbit/s", 2),
    Frame: version === undefined ? "–" : String(version),
    ...(live
      ? {
          "Behind live": number(status?.lagSeconds ?? undefined, "s"),
          "Camera to screen": number(delaySeconds ?? undefined, "s"),
        }
      : {}),
    Splats: picture ? picture.splats.toLocaleString("en") : "–",
    Anchors: picture?.anchors?.toLocaleString("en") ?? "–",
    Levels: status?.levels
      ? `${status.sentLevels ?? status.levels} of ${status.levels}`
      : String(viewer.scene?.levels ?? "–"),
    Decode: number(picture?.decodeMs, "ms"),
    Expand: number(picture?.expandMs, "ms"),
    Sort: number(picture?.sortMs, "ms"),
    Skipped: String(status?.skipped ?? 0),
    ...(picture?.drawn
      ? { Picture: `${picture.drawn.width} × ${picture.drawn.height}, JPEG ${picture.drawn.quality}` }
      : {}),
    Canvas: `${canvas.width} × ${canvas.height}, ${renderer.api}`,
  };
  list.replaceChildren(
    ...Object.entries(rows).flatMap(([name, value]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value }),
    ]),
  );
}
