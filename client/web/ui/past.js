/** What a server retains of a stream: asked for when it may have changed, for the timeline. */

const PAUSE_MS = 5000; // between two questions
const RENEW_MS = 60_000; // old groups leave, new ones come

/** @typedef {{ epoch: number, first: number, last: number, begun_ns?: number | null, first_time_ns?: number | null, last_time_ns?: number | null }} Group */

/**
 * Keep `timeline` told of all epochs that can be sought, and of when they were filmed.
 * @param {string} address - of the stream, up to its name, `.../v1/streams/main`
 * @param {string | null} token
 * @param {import("../view/viewer.js").Viewer} viewer
 * @param {import("./timeline.js").Timeline} timeline
 */
export function followPast(address, token, viewer, timeline) {
  let known = "",
    askedAt = -Infinity,
    asking = false;
  const ask = async () => {
    const { status } = viewer,
      { window: range } = status ?? {},
      now = performance.now();
    if (!range || status?.source === "recording" || asking) return;
    const shape = `${range.oldest.epoch} ${range.newest.epoch} ${range.oldest.version}`;
    if (now - askedAt < (shape === known ? RENEW_MS : PAUSE_MS) || document.hidden) return;
    [known, askedAt, asking] = [shape, now, true];
    try {
      const answer = await fetch(`${address}/manifest`, { headers: token ? { Authorization: `Bearer ${token}` } : {} });
      if (answer.ok) timeline.retained((await answer.json()).gops);
    } catch {} // without it the newest epoch can be sought
    asking = false;
  };
  viewer.addEventListener("status", ask);
}
