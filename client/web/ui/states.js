/** What is going on, in words: the chip at the top and the card in the middle. No page needed. */

/** @typedef {import("../stream/session.js").Status} Status */

/**
 * @typedef {object} Words
 * @property {string} chip - a word or two
 * @property {"live" | "good" | "busy" | "bad" | "quiet"} tone
 * @property {{ title: string, text: string, spinner: boolean, fraction?: number | null, button?: string } | null} card - null: nothing in the way
 */

const LONGEST = 60; // characters of the server's words in the chip

/** @type {(chip: string, tone: Words["tone"], title: string, text: string, more?: object) => Words} */
const full = (chip, tone, title, text, more = {}) => ({ chip, tone, card: { title, text, spinner: false, ...more } });

/**
 * @param {Status} status
 * @param {boolean} picture - whether a scene is on the screen already
 * @param {number} waitMs - until the next attempt, while reconnecting
 * @returns {Words}
 */
export function words(status, picture, waitMs) {
  const { phase, detail, trouble } = status;
  const seconds = Math.ceil(waitMs / 1000);
  switch (phase) {
    case "connecting":
      return picture ? { chip: "Connecting", tone: "busy", card: null } : full("Connecting", "busy", "Connecting", "Looking for the stream.", { spinner: true });
    case "waiting":
      if (picture) return { chip: "Loading", tone: "busy", card: null };
      return full("Waiting", "busy", status.fraction === null ? "Waiting for the first frame" : "Training the first frame",
        detail || "The picture appears as soon as there is one.", { spinner: true, fraction: status.fraction });
    case "live":
      if (!trouble) return { chip: "Live", tone: "live", card: null };
      return { chip: `Live, but ${trouble.length > LONGEST ? `${trouble.slice(0, LONGEST)}…` : trouble}`, tone: "busy", card: null };
    case "behind":
      return { chip: "Playing", tone: "good", card: null };
    case "paused":
      return { chip: "Paused", tone: "quiet", card: null };
    case "stalled":
      return { chip: "No new frames", tone: "busy", card: null };
    case "reconnecting": {
      const when = seconds > 0 ? `Trying again in ${seconds} s.` : "Trying again.";
      if (picture) return { chip: seconds > 0 ? `Reconnecting in ${seconds} s` : "Reconnecting", tone: "busy", card: null };
      return full("Reconnecting", "busy", detail ? "Not available now" : "The server does not answer", `${detail ? `${detail}. ` : ""}${when}`, { spinner: true, button: "Try now" });
    }
    case "ended":
      return picture ? { chip: "Ended", tone: "quiet", card: null } : full("Ended", "quiet", "This stream has ended", detail || "There is nothing to show any more.");
    case "failed":
      return full("Failed", "bad", "Something went wrong", detail || "The stream cannot be shown.", { button: "Reload" });
    case "version":
      return full("Outdated", "bad", "This page is out of date", "The server speaks another version of the protocol. Reload to get its page.", { button: "Reload" });
    case "denied":
      return full("No permission", "bad", "You may not watch this stream", detail || "Ask for a link that carries a token.");
    case "missing":
      return full("Not found", "bad", "No such stream", detail || "It may have been deleted.", { button: "Show streams" });
  }
}

/** Shown where the browser cannot draw. @type {Words} */
export const NO_WEBGL = full("Cannot draw", "bad", "This browser cannot show the scene",
  "WebGL2 is missing or switched off. Turn on hardware acceleration, or use a current browser.");

/** Position in time, for people: m:ss, or the frame number where the rate is unknown. @type {(versions: number, fps: number | null) => string} */
export function clock(versions, fps) {
  if (!fps) return String(Math.round(versions));
  const total = Math.abs(versions) / fps, minutes = Math.floor(total / 60), rest = Math.floor(total % 60);
  return `${minutes}:${String(rest).padStart(2, "0")}`;
}
