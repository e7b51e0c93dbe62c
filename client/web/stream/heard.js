/** Control messages of a server (docs/protocol.md), checked before they are used. */

export const VERSION = 1; // of the protocol
const MAX_CHARACTERS = 1 << 20; // of a message; 255 cameras need a third

const place = { epoch: 0, version: 0 },
  window = { oldest: place, newest: place, "newest_time_ns?": 0 };
const state = { state: "", "detail?": "" },
  progress = { "fraction?": 0, "text?": "" };
const welcome = {
  ...state,
  "epoch?": 0,
  "levels?": 0,
  "fps?": 0,
  "ack_every?": 0,
  "source?": "",
  "window?": window,
  "server_time_ns?": 0,
  "progress?": progress,
  "edges?": ["", 0],
  "together?": { "by?": "", may_present: true },
  "session?": "",
};

const real = -1e308,
  cameras = [{ name: "", width: 0, height: 0, intrinsics: [real, 9], world_to_camera: [real, 16] }, 0];

/**
 * Examples of each message: its fields are of these types, those with a question mark may be absent. Numbers are the
 * least allowed; lists give an item and the least length.
 * @type {Record<string, any>}
 */
const EXAMPLES = {
  __proto__: null,
  welcome,
  state,
  progress,
  window,
  epoch: { epoch: 0 },
  position: { mode: "", version: 0 },
  levels: { "levels?": 0 },
  skipped: { from: 0, to: 0 },
  presenter: {
    "by?": "",
    "view?": { position: [real, 3], rotation: [real, 9], distance: 0, focal: 0, stretch: 0, shift: [real, 2] },
    "at?": { mode: "", "epoch?": 0, "version?": 0 },
  },
  scene: { cameras, background: [real, 3], fps: 0, levels: 0, view_dependent: true },
  picked: { id: 0, "point?": [real, 3], depth: 0 },
};

/** Of the same type; numbers are finite and not below the example's. @type {(value: any, example: any) => boolean} */
function resembles(value, example) {
  if (value === null || typeof value !== typeof example) return false;
  if (typeof value === "number") return value >= example && value < Infinity;
  if (Array.isArray(example))
    return Array.isArray(value) && value.length >= example[1] && value.every((item) => resembles(item, example[0]));
  return (
    typeof value !== "object" ||
    Object.entries(example).every(([key, field]) => {
      const name = key.replace("?", "");
      return (name !== key && value[name] == null) || resembles(value[name], field);
    })
  );
}

/** Its type, or of events the event. @type {(message: any) => string} */
export const nameOf = ({ type, event }) => (type === "event" ? event : type);

/** The message, or null where no server of this protocol sends it. @type {(text: string) => any} */
export function heard(text) {
  let message = null;
  try {
    if (text.length <= MAX_CHARACTERS) message = JSON.parse(text);
  } catch {} // no JSON
  if (!resembles(message, { type: "" })) return null;
  const foreign = message.type === "welcome" && message.version !== VERSION; // what else it says may mean anything
  return foreign || resembles(message, EXAMPLES[nameOf(message)] ?? {}) ? message : null;
}
