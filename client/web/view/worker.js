/** The worker between socket and splats; `messages.js` says what it hears and tells. */

import { readMetadata } from "../decode/metadata.js";
import { Connection } from "../stream/connection.js";
import { Engine } from "./engine.js";
import { loadKernel, RECORD } from "../decode/expand.js";
import { BitstreamError, versionOf } from "../decode/scene.js";
import { digest } from "../decode/checksum.js";

/** @typedef {import("./messages.js").ToWorker} ToWorker */
/** @typedef {import("./messages.js").FromWorker} FromWorker */

const kernel = fetch(new URL("../decode/kernel.wasm", import.meta.url))
  .then((answer) => (answer.ok ? answer.arrayBuffer() : Promise.reject(new Error("kernel.wasm is missing"))))
  .then(loadKernel);

const MAX_HOLD_MS = 1500;
const MAX_MOVE_MS = 1000; // from state to state
const GAPS = 8; // between pictures, whose mean says how long to move

/** @type {Engine | null} */
let engine = null;
/** @type {Connection | import("../stream/recording.js").Recording | null} */
let source = null;
/** @type {string | null} what to play instead, should the stream turn out to play a file */
let file = null;
/** @type {import("./engine.js").EngineView | null} */
let view = null;
let keyframe = -1; // of the scene that was told of
let scheduled = false;
let refusals = 0;
let decodeMs = 0;
let timeMs = 0; // presentation time of the newest frame
let before = { version: -1, timeMs }; // of the newest picture
let gapMs = NaN; // between what pictures that follow each other show, in the mean
/** @type {number | null} version to reach before the next picture */
let held = null;
/**
 * Of the newest picture: what the status said.
 * @type {Pick<import("../stream/session.js").Status, "position" | "filmedMs" | "lagSeconds">}
 */
let shown = { position: null, filmedMs: null, lagSeconds: null };

/** @type {(message: FromWorker, transfer?: Transferable[]) => void} */
const tell = (message, transfer = []) => self.postMessage(message, { transfer });

/**
 * Decode one packet; null where it is refused.
 * @type {(bytes: Uint8Array) => Promise<{ version: number, ms: number, filmedMs: number } | null>}
 */
async function decode(bytes) {
  engine ??= new Engine(await kernel);
  const start = performance.now();
  try {
    timeMs = engine.push(bytes).packet.timeMs;
  } catch (error) {
    if (!(error instanceof BitstreamError)) throw error;
    refusals++;
    tell({ type: "refused", code: error.code, detail: error.message });
    return null;
  }
  decodeMs = performance.now() - start;
  const version = versionOf(/** @type {any} */ (engine.scene));
  if (version === held) held = null;
  if (source) source.session.status.fps ??= engine.scene?.header.fps ?? null; // the welcome of a stream that starts does not know
  schedule();
  return { version, ms: decodeMs, filmedMs: timeMs };
}

/** Make a picture soon: after the messages that wait, so that the newest view wins. */
function schedule() {
  if (scheduled) return;
  scheduled = true;
  channel.port2.postMessage(0);
}

const channel = new MessageChannel();
channel.port1.onmessage = () => {
  scheduled = false;
  picture();
};

/** Questions about a scene whose splats do not exist yet. @type {Extract<ToWorker, { type: "pick" | "depth" }>[]} */
let questions = [];

/** @param {Extract<ToWorker, { type: "pick" | "depth" }>} question */
function answer({ type, id, origin, direction }) {
  const point =
    type === "pick"
      ? engine?.pick(origin, direction)
      : /** @type {[number, number, number]} */ ([0, 0, engine?.depthAlong(origin, direction) ?? 0]);
  tell({ type: "picked", id, point: point ?? null });
}

/** The mean of gaps after one more. @param {number} newest */
function gapAfter(newest) {
  return Number.isNaN(gapMs) ? newest : gapMs + (newest - gapMs) / GAPS;
}

function picture() {
  const scene = engine?.scene;
  if (!engine || !scene || held !== null) return;
  if (scene.keyframe !== keyframe) {
    ({ keyframe } = scene);
    const { cameras, background, fps, levels, viewDependent } = scene.header;
    const { exposures } = scene.metadata ? readMetadata(scene.metadata) : { exposures: undefined };
    tell({
      type: "scene",
      cameras,
      background: [background[0], background[1], background[2]],
      fps,
      levels,
      viewDependent,
      exposures,
    });
  }
  if (!view) return;
  const result = engine.picture(view);
  if (!result) return;
  const { spans, order, version } = result;
  // What is live jumps, since moving makes it late. Played pictures move, all for as long, even where they were filmed
  // unevenly: sound is as late as they are.
  const follows = source?.session.status.mode === "replay" && version === before.version + 1;
  if (follows) gapMs = gapAfter(Math.min(timeMs - before.timeMs, MAX_MOVE_MS));
  const overMs =
    source && follows ? Math.min(gapMs / source.speed, MAX_MOVE_MS) : version === before.version ? null : 0;
  before = { version, timeMs };
  const transfer = [...(order ? [order.buffer] : []), ...spans.map(({ data }) => data.buffer)];
  const { position = null, filmedMs = null, lagSeconds = null } = source?.session.status ?? {};
  shown = { position, filmedMs, lagSeconds };
  tell({ type: "picture", ...result, timeMs, overMs, decodeMs, position }, /** @type {any} */ (transfer));
  questions.forEach(answer);
  questions = [];
}

function status() {
  if (!source) return;
  const { status } = source.session; // on the way to a version, what is shown counts
  if (file && status.source === "recording") return void playFile(file, source.token, status.loops);
  tell({
    type: "status",
    status: { ...status, ...(held === null ? {} : shown), stopping: source.stopping },
    refusals,
    now: performance.now(),
  });
}

let holdTimer = 0;
/** Keep the picture until `version` is reached, for a while at most. @param {number | null} version */
function hold(version) {
  clearTimeout(holdTimer);
  held = version;
  if (version === null) schedule();
  else holdTimer = self.setTimeout(() => hold(null), MAX_HOLD_MS);
}

/** @param {{ version: number, timeMs: number }[]} list */
const moments = (list) => tell({ type: "moments", moments: list });

/** @param {ArrayBuffer} piece */
const sound = (piece) => tell({ type: "heard", piece }, [piece]);

const handlers = { packet: decode, hold, status, sound, moments };

/**
 * Watch a file; what plays it is loaded now.
 * @type {(url: string, token: string | null, loop: boolean) => Promise<void>}
 */
async function playFile(url, token, loop) {
  source?.close();
  source = file = engine = held = null; // a file that is dropped follows another stream
  shown = { position: null, filmedMs: null, lagSeconds: null };
  keyframe = -1;
  before = { version: -1, timeMs: 0 };
  gapMs = NaN;
  const { Recording } = await import("../stream/recording.js");
  source = new Recording(url, token, handlers, loop);
  status();
}

/** @param {MessageEvent<ToWorker>} event */
self.onmessage = ({ data: message }) => {
  switch (message.type) {
    case "connect":
      if (!message.live) return playFile(/** @type {string} */ (message.file), message.token, false);
      ({ file } = message);
      source = new Connection(message.live, message.token, handlers);
      source.session.wishes = message.wishes;
      status();
      break;
    case "view":
      view = message.view;
      schedule();
      break;
    case "send":
      source?.send(message.messages);
      break;
    case "wishes":
      if (source) source.session.wishes = message.wishes;
      source?.send([{ type: "set", ...message.wishes }]);
      break;
    case "listen":
      if (source instanceof Connection) source.listen(message.on);
      break;
    case "hurry":
      source?.hurry();
      break;
    case "texture":
      engine?.forgetTexture();
      schedule();
      break;
    case "pick":
    case "depth":
      if (engine?.scene && !engine.fresh) answer(message);
      else questions.push(message);
      break;
    case "inspect":
      tell(inspect(message.id));
      break;
    case "close":
      source?.close();
      self.close();
  }
};

/** The state as other decoders can be compared with. @type {(id: number) => FromWorker} */
function inspect(id) {
  const scene = engine?.scene,
    expander = engine?.expander;
  if (!engine || !scene || !expander) return { type: "inspected", id, state: null };
  const shown = new Float32Array(engine.activeCount * RECORD);
  for (let i = 0; i < engine.activeCount; i++) {
    const at = engine.active[i] * RECORD;
    shown.set(expander.numbers.subarray(at, at + RECORD), i * RECORD);
  }
  const digests = scene.levels.map(digest);
  return {
    type: "inspected",
    id,
    state: { version: versionOf(scene), versions: scene.versions, digests, splats: shown },
  };
}
