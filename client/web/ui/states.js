/** What is going on, in words: the chip at the top and the card in the middle. No page needed. */

/**
 * @typedef {object} Words
 * @property {string} chip - a word or two
 * @property {"live" | "good" | "busy" | "bad" | "quiet"} tone
 * @property {{ title: string, text: string, spinner: boolean, fraction?: number | null, button?: string, asks?: boolean } | null} card - null: nothing in the way
 */

const MAX_CHARACTERS = 400; // characters of the server's words in the chip
const WAITING_AT = 0.05,
  TRAINING_FROM = 0.1,
  TRAINING = 0.8,
  LOADING_AT = 0.95; // on the bar that leads from the first word to the picture
const WITHOUT_PICTURE = ["connecting", "reconnecting", "deleted", "failed", "version", "denied", "missing"];

/** @type {(chip: string, tone: Words["tone"], title: string, text: string, more?: object) => Words} */
const full = (chip, tone, title, text, more = {}) => ({
  chip,
  tone,
  card: { title, text: text.charAt(0).toUpperCase() + text.slice(1), spinner: false, ...more },
});

/** What is going on, with what is wrong and what to do. @type {(what: string, trouble: string, link?: string) => string} */
function but(what, trouble, link = ", but ") {
  if (!trouble) return what;
  return `${what}${link}${trouble.length > MAX_CHARACTERS ? `${trouble.slice(0, MAX_CHARACTERS)}…` : trouble}`;
}

/** How far back, for people. @type {(seconds: number | null) => string} */
function behind(seconds) {
  if (seconds === null) return "Behind live";
  return `${duration(seconds)} behind live`;
}

/** As exact as it is of use: 3.2 s, 48 s, 7:29. @type {(seconds: number) => string} */
export function duration(seconds) {
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  return seconds < 59.5 ? `${Math.round(seconds)} s` : clock(seconds).slice(0, -2);
}

/**
 * @param {import("../stream/session.js").Status} status
 * @param {boolean} picture - whether a scene is on the screen already
 * @param {number} waitMs - until the next attempt, while reconnecting
 * @returns {Words}
 */
export function words(status, picture, waitMs) {
  const { phase, detail, stage, trouble, fraction, source } = status;
  const seconds = Math.ceil(waitMs / 1000);
  /** @type {(chip: string, tone: Words["tone"]) => Words} */
  const small = (chip, tone) => ({ chip, tone, card: null });
  if (!picture && status.window && !WITHOUT_PICTURE.includes(phase)) {
    // decoded, or on its way: say nothing else before it is seen
    return full("Loading", "busy", "Loading", "The picture is on its way.", { spinner: true, fraction: LOADING_AT });
  }
  switch (phase) {
    case "connecting":
      return picture
        ? small("Connecting", "busy")
        : full("Connecting", "busy", "Connecting", "Looking for the stream.", { spinner: true, fraction: 0 });
    case "waiting":
      if (picture) return small("Loading", "busy");
      return full(
        "Waiting",
        "busy",
        fraction === null ? "Waiting for the first frame" : "Training the first frame",
        detail || stage || "The picture appears as soon as there is one.",
        { spinner: true, fraction: fraction === null ? WAITING_AT : TRAINING_FROM + TRAINING * fraction },
      );
    case "preview":
      return small(
        but(
          fraction === null ? "Waiting for new frames" : `Preview, trained to ${Math.round(100 * fraction)} %`,
          trouble,
        ),
        "busy",
      );
    case "live":
      if (trouble) return small(but("Live", trouble), "busy");
      return source === "cameras" ? small("Live", "live") : small("Newest frame", "good");
    case "behind":
      return small(source === "cameras" ? behind(status.lagSeconds) : "Playing", "good");
    case "replay":
      return small(but("Replay", trouble), "good");
    case "paused":
      return small("Paused", "quiet");
    case "stalled":
      return small(but("No new frames", trouble, ": "), "busy");
    case "reconnecting": {
      const when = seconds > 0 ? ` in ${seconds} s` : "";
      if (picture) return small(`Reconnecting${when}`, "busy");
      return full(
        "Reconnecting",
        "busy",
        detail ? "Not available now" : "The server does not answer",
        `${detail && `${detail}. `}Trying again${when}.`,
        { spinner: true, button: "Try now" },
      );
    }
    case "ended":
      return picture
        ? small(but("Ended", trouble), "quiet")
        : full("Ended", "quiet", "This stream has ended", detail || "There is nothing to show any more.");
    case "deleted":
      if (picture) return small("Deleted, this is its last picture", "bad");
      return full("Deleted", "bad", "This stream was deleted", detail || "There is nothing to show any more.", {
        button: "Show streams",
      });
    case "failed":
      return full("Failed", "bad", "Something went wrong", detail || "The stream cannot be shown.", {
        button: "Reload",
      });
    case "version":
      return full(
        "Outdated",
        "bad",
        "This page is out of date",
        "The server speaks another version of the protocol. Reload to get its page.",
        { button: "Reload" },
      );
    case "denied":
      return full(
        "No permission",
        "bad",
        "You may not watch this stream",
        detail || "Ask for a link that carries a token.",
        { button: "Watch", asks: true },
      );
    case "missing":
      return full("Not found", "bad", "No such stream", detail || "It may have been deleted.", {
        button: "Show streams",
      });
  }
}

/** Shown where the browser cannot draw. @type {Words} */
export const NO_WEBGL = full(
  "Cannot draw",
  "bad",
  "This browser cannot show the scene",
  "WebGL2 is missing or switched off. Turn on hardware acceleration, or use a current browser.",
);

/** Shown while the browser has taken the graphics card away. @type {(button: string) => Words} */
export const lostGraphics = (button) =>
  full(
    "No graphics",
    "bad",
    "The graphics card was taken away",
    "The browser, or another program, ended this page's drawing. It goes on by itself as soon as the browser allows.",
    { button },
  );

/** A time, for people: m:ss.t. @type {(seconds: number) => string} */
export function clock(seconds) {
  const tenths = Math.floor(10 * Math.abs(seconds) + 1e-3),
    minutes = Math.floor(tenths / 600);
  return `${minutes}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
}
