/** The page on which a phone or laptop films as one camera of a live stream (docs/filming.md). */

import { PushLink } from "../stream/push.js";
import { devices, isSlow, openCamera } from "../view/device.js";
import { Filming } from "../view/filming.js";
import { Microphone } from "../view/microphone.js";
import { button, element, keepInAddress } from "./page.js";

const MAX_REFUSALS = 10; // of pictures one after the other, then filming ends
const MAX_NEED = 40; // letters of the server's word about the board
const MAX_COMPLAINT = 300; // letters of the same about its place or name
const FIGURES_MS = 1000;
const STALLED_MS = 3000;
const RACE_MS = 10_000; // since filming began, within which a lost name was one that two phones were offered at once
const FULL_SIZE = { width: 1280, height: 720 }; // before the server has said which it wants
const options = new URLSearchParams(location.search);
const stream = options.get("stream") ?? "main";
const video = /** @type {HTMLVideoElement} */ (element("picture"));
const names = /** @type {HTMLSelectElement} */ (element("name"));
const choice = /** @type {HTMLSelectElement} */ (element("device"));

/** @type {Filming | null} */
let filming = null;
/** @type {Microphone | null} */
let microphone = null;
let silence = ""; // why there is no sound, where it is wanted
let trouble = ""; // why filming ended
let chosen = options.get("camera"); // name of the camera that this is to be
let isInterrupted = false; // the camera was taken away while the page was hidden, as where the screen was locked
let offeredAt = -Infinity; // when it began to film under a name that nobody had chosen
const link = openLink();

function openLink() {
  const address = new URL(`v1/streams/${encodeURIComponent(stream)}/ingest`, new URL(".", location.href));
  address.protocol = address.protocol.replace("http", "ws");
  for (const name of ["camera", "expires", "incarnation", "signature"]) {
    const value = options.get(name);
    if (value !== null && options.has("signature")) address.searchParams.set(name, value);
  }
  return new PushLink(address.href, options.get("token"), () => {
    if (filming && link.state === "ended") stop("");
    fillNames();
    if (filming && link.refusals >= MAX_REFUSALS) {
      const { name } = filming,
        isAnothers = link.refusal.includes("another phone");
      const isRace = performance.now() - offeredAt < RACE_MS;
      if (isRace) chosen = null; // else the name stays: with another one, its pictures would count as filmed from another place
      const way = isAnothers
        ? `If this is ${name}, press Stop there and Film here; else choose another name.`
        : "Press Film again.";
      stop(`The server refuses ${name}: it ${link.refusal}. ${way}`);
      if (isRace && link.cameras.some(({ taken }) => !taken)) start();
    }
    tell();
  });
}

/** The names that the stream waits for; unless one was chosen, the first that nobody has. */
function fillNames() {
  const texts = link.cameras.map(({ name, taken }) => (taken && !filming ? `${name} (in use)` : name));
  if (texts.join("\n") !== [...names.options].map(({ text }) => text).join("\n")) {
    const before = names.value;
    names.replaceChildren(...link.cameras.map(({ name }, row) => new Option(texts[row], name)));
    names.value = before;
  }
  const isFree = (/** @type {{ taken: boolean }} */ { taken }) => !taken,
    had = link.cameras.find(({ name }) => name === formerName());
  const mine =
    link.cameras.find(({ name }) => name === (filming?.name ?? chosen)) ??
    [had, ...link.cameras].find((one) => one && isFree(one)) ??
    had;
  names.value = mine?.name ?? link.cameras[0]?.name ?? "";
}

/** The name under which this device filmed for the stream before its page was closed; it stands where that one stood. */
function formerName() {
  try {
    return localStorage.getItem(`camera of ${stream}`);
  } catch {
    return null; // the browser keeps nothing
  }
}

/** Remember the name that this device has. @param {string} name */
function keepName(name) {
  keepInAddress("camera", (chosen = name));
  try {
    localStorage.setItem(`camera of ${stream}`, name);
  } catch {} // as above
}

async function start() {
  trouble = "";
  isInterrupted = false;
  end(); // many phones open one camera at a time
  try {
    const wanted = link.cameras.find(({ name }) => name === names.value),
      size = wanted ?? FULL_SIZE;
    const silent = () => openCamera(choice.value, size, link.fps, false);
    const media = await (wanted?.sound ? openCamera(choice.value, size, link.fps, true).catch(silent) : silent());
    video.srcObject = media;
    video.hidden = false;
    await video.play();
    await link.askCameras();
    fillNames();
    offeredAt = chosen === null ? performance.now() : -Infinity;
    filming = new Filming(link, video, media, names.value, options.get("codec") === "jpeg", tell);
    if (link.cameras.find(({ name }) => name === names.value)?.sound) listen(media, names.value);
    filming.track.onended = () => {
      stop("The camera was taken away by another program.");
      isInterrupted = document.hidden;
    };
    keepName(filming.name);
    await fillDevices(filming.track.getSettings().deviceId ?? "");
  } catch (error) {
    stop(refusalOf(error));
  }
  tell();
}

/** Send the sound of `media`, too. @param {MediaStream} media @param {string} name */
function listen(media, name) {
  silence = media.getAudioTracks().length
    ? ""
    : "No sound is sent: there is no microphone, or the page may not use it. Allow it in the page's settings, beside its address, then press Stop and Film.";
  if (silence) return;
  media.getAudioTracks()[0].onended = () => {
    silence = "No sound is sent any more: the microphone was taken away. Press Stop, then Film.";
    tell();
  };
  microphone = new Microphone(
    media,
    options.get("sound") === "pcm",
    (takenMs, codec, sound) => link.hasRoom && link.send(name, takenMs, codec, sound),
  );
  microphone.ready.catch(() => {
    silence = "No sound is sent: this browser gives none.";
    tell();
  });
}

/** @param {unknown} error */
function refusalOf(error) {
  const name = error instanceof Error ? error.name : "";
  if (name === "NotAllowedError")
    return "The browser may not use the camera: allow it in the page's settings, beside its address.";
  if (name === "NotFoundError") return "This device has no camera that the browser can use.";
  if (name === "NotReadableError") return "The camera is used by another program.";
  return `The camera cannot be opened: ${error instanceof Error ? error.message : error}.`;
}

/** @param {string} chosen */
async function fillDevices(chosen) {
  const found = await devices(),
    usual = chosen ? [] : [new Option("rear camera", "")];
  choice.replaceChildren(...usual, ...found.filter(({ id }) => id).map(({ id, label }) => new Option(label, id)));
  choice.value = chosen;
}

function end() {
  filming?.stop();
  microphone?.stop();
  filming = microphone = null;
  silence = "";
}

/** @param {string} why */
function stop(why) {
  if (filming) link.renew(); // others may have its name
  end();
  video.hidden = true;
  trouble = why;
  fillNames();
  tell();
}

/** @returns {[string, string]} the tone and the sentence */
function state() {
  if (trouble) return ["bad", trouble];
  if (link.state === "ended")
    return [
      "bad",
      `The server does not take pictures from here: ${link.detail}.${link.isDenied && options.has("token") ? " Open this page by a link with another token." : ""}`,
    ];
  if (link.state === "waiting") return ["busy", `Trying again: ${link.detail}.`];
  if (link.state === "connecting") return ["busy", "Connecting"];
  if (!link.cameras.length) return ["bad", `Stream ${stream} waits for no camera that a phone could be.`];
  if (!filming) return ["good", `Ready to film for stream ${stream}.`];
  if (filming.turned) return ["bad", "Turn the phone: the stream wants the other side up."];
  if (performance.now() - filming.newest > STALLED_MS)
    return ["bad", "The camera gives no pictures: keep this page in front."];
  const complaint = String(link.cameras.find(({ name }) => name === filming?.name)?.complaint ?? "").slice(
    0,
    MAX_COMPLAINT,
  );
  if (complaint) return ["bad", `Filming as ${filming.name}, but ${complaint}.`];
  return ["live", `Filming as ${filming.name}.`];
}

/** @returns {string[]} what is worth a word while filming */
function notes() {
  if (!filming) return [];
  const { held, awake } = filming,
    found = [];
  if (hold.ariaPressed === "true" && held?.free.length)
    found.push(`This browser does not hold: ${held.free.join(", ")}.`);
  if (!awake) found.push("Keep the screen on: this browser does not do it.");
  if (isSlow(rates.filmed, link.fps))
    found.push(`The camera gives ${rates.filmed.toFixed(0)} pictures a second; the stream wants ${link.fps}.`);
  if (silence) found.push(silence);
  if (rates.dropped) found.push("The line or this device is too slow: pictures are left out.");
  return found;
}

/** What who carries the board is to know, from afar. */
function tellBoard() {
  const sight =
    filming && link.state === "open" ? link.cameras.find(({ name }) => name === filming?.name)?.board : undefined;
  const board = element("board"),
    seen = sight?.seen === true,
    needs = String(sight?.needs ?? "").slice(0, MAX_NEED);
  board.hidden = !sight;
  board.classList.toggle("seen", seen || !needs);
  const text = !needs ? "enough" : seen ? `the board is seen, now: ${needs}` : `the board: ${needs}`;
  if (sight && board.textContent !== text) board.textContent = text; // is read out only when it is another
}

const hold = button("hold");
const rates = { filmed: 0, sent: 0, bytes: 0, dropped: 0 };
let shown = "";

function tell() {
  const [tone, text] = state();
  document.body.dataset.tone = tone;
  element("status-text").textContent = text;
  button("film").textContent = filming ? "Stop" : "Film";
  button("film").disabled = !filming && (link.state === "ended" || !link.cameras.length); // as what it is to film is not known
  names.disabled = filming !== null;
  hold.hidden = !filming;
  tellBoard();
  const lines = notes();
  if (lines.join() !== shown)
    element("notes").replaceChildren(
      ...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })),
    );
  shown = lines.join();
}

/** @type {{ of: Filming | null, at: number, filmed: number, sent: number, bytes: number, dropped: number } | null} */
let before = null;

function showFigures() {
  if (link.state === "open") link.ask({ type: "cameras" }); // others may have begun to film, or the board to be walked
  const dropped = (filming?.dropped ?? 0) + link.counts.dropped;
  const now = {
    of: filming,
    at: performance.now(),
    filmed: filming?.filmed ?? 0,
    sent: filming?.sent ?? 0,
    bytes: link.counts.bytes,
    dropped,
  };
  const since = filming && before?.of === filming ? before : null; // one that has just begun has no rate yet
  const seconds = since ? (now.at - since.at) / 1000 : 0;
  for (const name of /** @type {const} */ (["filmed", "sent", "bytes", "dropped"]))
    rates[name] = since ? Math.max(0, now[name] - since[name]) / seconds : 0;
  before = now;
  element("figures").hidden = !filming;
  const { clock, counts } = link,
    known = clock.count > 0;
  const facts = {
    Picture: `${filming?.size ?? ""}, ${filming?.encoder?.codec ?? "none yet"}`,
    Sound: microphone ? (microphone.encoder ? "Opus" : "samples") : "none",
    Sent: since ? `${rates.sent.toFixed(0)} a second, ${((rates.bytes * 8) / 1e6).toFixed(1)} Mbit/s` : "not known yet",
    "Left out": `${dropped}`,
    Refused: counts.refused ? `${counts.refused}: ${link.refusal}` : "0",
    Clock: known
      ? `server's ${describeMs(clock.at(now.at) - Date.now())}, to ${clock.errorAt(now.at).toFixed(1)} ms`
      : "not known yet",
  };
  element("figures").replaceChildren(
    ...Object.entries(facts).flatMap(([name, value]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value }),
    ]),
  );
  tell();
}

/** @param {number} ms */
const describeMs = (ms) => `${Math.abs(ms).toFixed(1)} ms ${ms < 0 ? "behind" : "ahead"}`;

if (!window.isSecureContext || !navigator.mediaDevices) {
  link.close();
  document.body.dataset.tone = "bad";
  const better = `https${location.href.slice(location.protocol.length - 1)}`;
  element("status-text").textContent =
    `Browsers give the camera only to pages with https in their address: open ${better}, or this page on the server's own machine as localhost.`;
  element("controls").hidden = true;
} else if (!("requestVideoFrameCallback" in video)) {
  link.close();
  document.body.dataset.tone = "bad";
  element("status-text").textContent = "This browser is too old to say when a picture was taken: update it.";
  element("controls").hidden = true;
} else {
  element("controls").addEventListener("submit", (event) => {
    event.preventDefault();
    filming ? stop("") : start();
  });
  choice.addEventListener("change", () => filming && start());
  names.addEventListener("change", () => (chosen = names.value));
  hold.addEventListener("click", () => {
    hold.ariaPressed = String(hold.ariaPressed !== "true");
    filming?.hold(hold.ariaPressed === "true");
  });
  document.addEventListener("visibilitychange", () => {
    before = null; // a hidden page gets few pictures or none
    if (document.hidden) return;
    if (isInterrupted) start();
    if (!filming) return;
    filming.stayAwake();
    video.play().catch(() => {}); // some browsers pause it while the page is hidden
  });
  setInterval(showFigures, FIGURES_MS);
  fillDevices("").catch(() => {});
  tell();
}
