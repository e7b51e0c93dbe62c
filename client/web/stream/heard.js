/** Control messages of a server (docs/protocol.md): their fields are checked before anything of them is used. */

/** @typedef {(value: any) => boolean} Test */

export const VERSION = 1; // of the protocol
const MAX_CHARACTERS = 65536; // of a message

/** @type {Test} */
const isObject = (x) => typeof x === "object" && x !== null;
/** @type {Test} */
const isText = (x) => typeof x === "string";
/** @type {Test} */
const isNumber = (x) => Number.isFinite(x);
/** @type {Test} */
const isWhole = (x) => Number.isSafeInteger(x) && x >= 0;
/** @type {Test} */
const isPosition = (x) => isObject(x) && isWhole(x.epoch) && isWhole(x.version);
/** @type {Test} */
const isWindow = (x) => isObject(x) && isPosition(x.oldest) && isPosition(x.newest);
/** @type {(test: Test) => Test} */
const optional = (test) => (x) => x === null || x === undefined || test(x);
const state = { state: isText, detail: optional(isText) };
const progress = { fraction: optional(isNumber), text: optional(isText) };

/** What the fields of each message must be; others are not looked at. @type {Record<string, Record<string, Test>>} */
const FIELDS = {
  welcome: {
    ...state, epoch: optional(isWhole), levels: optional(isWhole), ack_every: optional(isWhole), source: optional(isText),
    fps: optional((x) => isNumber(x) && x > 0), window: optional(isWindow), server_time_ns: optional(isNumber),
    progress: optional((x) => isObject(x) && suits(x, progress)),
  },
  state,
  progress,
  epoch: { epoch: isWhole },
  position: { mode: (x) => ["live", "replay", "paused"].includes(x), version: isWhole },
  levels: { levels: optional(isWhole) },
  skipped: { from: isWhole, to: isWhole },
  window: { oldest: isPosition, newest: isPosition },
};

/** @type {(message: any, fields: Record<string, Test>) => boolean} */
const suits = (message, fields) => Object.entries(fields).every(([name, test]) => test(message[name]));

/** Name of a message: its type, or of events the event. @type {(message: any) => string} */
export const nameOf = (message) => (message.type === "event" ? message.event : message.type);

/** The message, or null where it is none that a server of this protocol sends. @type {(text: string) => any} */
export function heard(text) {
  if (text.length > MAX_CHARACTERS) return null;
  let message;
  try {
    message = JSON.parse(text);
  } catch {
    return null;
  }
  if (!isObject(message) || !isText(message.type)) return null;
  const name = nameOf(message), known = isText(name) && Object.hasOwn(FIELDS, name);
  const foreign = name === "welcome" && message.version !== VERSION; // what else it says may mean anything
  return !known || foreign || suits(message, FIELDS[name]) ? message : null;
}
