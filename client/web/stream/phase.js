/** What is going on, as one word; decided here alone. What each means is in docs/viewer.md, "What the page says". */

/**
 * @typedef {"connecting" | "waiting" | "preview" | "live" | "behind" | "replay" | "paused" | "stalled" | "reconnecting" | "ended"
 *   | "deleted" | "failed" | "version" | "denied" | "missing"} Phase
 */

/** @typedef {"cameras" | "data" | "recording"} Source - live cameras, pictures taken earlier that are trained now, a recorded bitstream */

/**
 * @typedef {object} Facts
 * @property {"opening" | "open" | "broken"} link
 * @property {Phase | null} verdict - why there will be no further attempt
 * @property {string} stream - its state in the server's words, "" while unknown
 * @property {Source} source
 * @property {"live" | "replay" | "paused"} mode
 * @property {boolean} hasFrame - whether a frame was decoded; of a stream that starts, on this connection
 * @property {boolean} hasWindow - whether there is anything to show
 * @property {boolean} isOver - whether a recording has reached its end
 * @property {boolean} isBehind - whether what is shown is older than the newest frame, by more than can be on its way
 * @property {boolean} isQuiet - whether frames are overdue
 */

export const LIVE_SECONDS = 2; // the window is told once a second: less cannot be known

const OVER = ["ended", "idle"]; // states of a stream to which no frame is added

/** @type {(facts: Facts) => Phase} */
export function phaseOf({ link, verdict, stream, source, mode, hasFrame, hasWindow, isOver, isBehind, isQuiet }) {
  if (verdict) return verdict;
  if (link === "opening") return "connecting";
  if (link === "broken") return "reconnecting";
  if (stream === "failed") return "failed";
  if (!hasFrame) return stream === "ended" && !hasWindow ? "ended" : "waiting";
  if (mode === "paused") return "paused";
  if (isOver || (mode === "live" && OVER.includes(stream))) return "ended";
  if (stream === "starting") return "preview";
  if (isQuiet) return "stalled";
  if (source === "recording") return "replay";
  return mode === "live" && !isBehind ? "live" : "behind";
}
