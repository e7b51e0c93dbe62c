/** The page: puts viewer, controls and panels together. */

import { fromText, toText } from "../view/camera.js";
import { Controls } from "../view/controls.js";
import { createHandle, listenToParent } from "./handle.js";
import { attachMenu, button, element, menuItem, toast } from "./page.js";
import { Quality, QUALITIES } from "../view/quality.js";
import { lostGraphics, NO_WEBGL, words } from "./states.js";
import { Delay, describe, hideWhenIdle, show } from "./status.js";
import { chooseStream, countWatchers, liveAddress, serverPath, showStreams } from "./streams.js";
import { Flight } from "./fly.js";
import { attachPhone } from "./phone.js";
import { Rig, showSource } from "./rig.js";
import { attachSharing, copyMoment, savePicture } from "./sharing.js";
import { fillStatistics, Rates } from "./statistics.js";
import { followPast } from "./past.js";
import { backgroundItems, colourOf } from "./background.js";
import { attachDrop } from "./drop.js";
import { blurOf, lensItems } from "./lens.js";
import { MOVING, Timeline } from "./timeline.js";
import { Together } from "./together.js";
import { drawHere } from "../view/drawing.js";
import { Viewer } from "../view/viewer.js";

const OF_SLIDERS = new Set(["arrowleft", "arrowright", "arrowup", "arrowdown", "home", "end", "pageup", "pagedown"]);
const MAX_BLUR_PX = 18; // where nothing was seen
const OPENING_AFTER_MS = 600; // after the first picture
const SLOW_MS = 10_000; // that the way out of slow drawing is offered
const BACK_AT = 0.4; // how far outside of what the rig has seen a way back is offered
const options = new URLSearchParams(location.search);
let recording = options.get("src"); // the address of a file that is played
const canvas = /** @type {HTMLCanvasElement} */ (element("canvas"));
document.body.classList.toggle("embed", options.get("embed") === "1");
document.body.classList.toggle("still", options.get("sway") === "0");
document.body.classList.toggle("framed", window.parent !== window);
document.body.classList.toggle("bare", options.get("ui") === "0");

/** @returns {Promise<Viewer | null>} drawn here if that can be, else by the server */
async function createViewer() {
  try {
    if (options.get("thin") !== "1" || recording)
      return new Viewer(canvas, await drawHere(canvas, options.get("webgpu")));
  } catch {
    if (recording) return cannotDraw();
  }
  try {
    const { createThin } = await import("../view/thin.js");
    return new Viewer(canvas, createThin(canvas));
  } catch {
    return cannotDraw();
  }
}

function cannotDraw() {
  show(NO_WEBGL);
  element("tools").hidden = true;
  return null;
}

/** @param {Viewer} viewer */
async function start(viewer) {
  const timeline = new Timeline((/** @type {any[]} */ messages) => {
    if (messages.some(({ type }) => type === "seek" || type === "play")) options.delete("t"); // who went elsewhere is not led back to a link's moment
    viewer.tell({ type: "send", messages });
  }, options.get("marks"));
  const delay = new Delay();
  const controls = new Controls(viewer);
  const quality = new Quality(viewer, options.get("quality") ?? (viewer.thin ? "high" : null));
  const rates = new Rates();
  const flight = new Flight(viewer, timeline);
  const together = new Together(viewer, timeline);
  const isShared = viewer.thin || (!recording && options.get("together") === "1"); // a played file is seen where the server plays it
  const token = recording ? null : options.get("token"); // files of other servers must not get it
  let told = false; // that the server can draw
  let retryAt = 0,
    shown = -1,
    place = "";

  const destroy = () => {
    controls.destroy();
    viewer.destroy();
  };
  const handle = createHandle(viewer, timeline, delay, destroy);
  Object.defineProperty(window, "streamlod", { value: handle });
  listenToParent(handle);

  const refresh = () => {
    const { status } = viewer,
      { isLost } = viewer.painter;
    if (!status) return;
    delay.show(status, isLost);
    element("stage").toggleAttribute("data-lost", isLost); // browsers draw a canvas without graphics as a broken image
    show(
      isLost
        ? lostGraphics(recording ? "Reload" : "Let the server draw")
        : words(status, viewer.picture !== null, retryAt - performance.now()),
    );
    timeline.update(status);
    if (timeline.stands) wake();
  };
  viewer.addEventListener("status", (event) => {
    const { status, now } = /** @type {CustomEvent} */ (event).detail;
    retryAt = performance.now() + Math.max(0, status.retryAt - now);
    if (viewer.scene) status.fps ??= viewer.scene.fps;
    if (status.source === "recording" && !timeline.recording && !isShared) timeline.playFile(status.loops);
    quality.limit(status.levels ?? viewer.scene?.levels ?? null);
    refresh();
    openMoment();
  });
  /** A link may name a moment: stand still there, once. */
  const openMoment = () => {
    const t = options.get("t"),
      epoch = options.get("epoch");
    if (t === null || !viewer.scene || !timeline.window) return;
    options.delete("t");
    if (/^\d+$/.test(t)) timeline.showMoment(Number(t), epoch === null ? null : Number(epoch));
  };
  viewer.addEventListener("picture", (event) => {
    const { detail } = /** @type {CustomEvent} */ (event);
    // Both, as a later one may be decoded already, and the timeline takes one for the time of the other.
    if (detail.position && viewer.status)
      Object.assign(viewer.status, { position: detail.position, filmedMs: detail.timeMs ?? null });
    element("stage").toggleAttribute("data-shown", true);
    openMoment(); // where the scene came after the status
    rates.frame(detail, viewer.status?.bytes ?? 0);
    if (detail.position && detail.timeMs !== undefined) timeline.filmed(detail.position, detail.timeMs);
    delay.picture(detail.timeMs ?? (detail.position && timeline.filmedAt(detail.position)));
    if (detail.version !== shown) refresh(); // the same frame from elsewhere changes nothing around it
    shown = detail.version;
  });
  /** @param {string | null} address - null for live sound @param {import("./sound.js").Told | null} told */
  const offerSound = async (address, told) => {
    if (viewer.thin) return; // pictures that the server draws do not say when they were filmed
    const played = recording,
      { Sound } = await import("./sound.js");
    if (recording === played) viewer.sound ??= new Sound(viewer, timeline, address, token, told);
  };
  viewer.addEventListener("sound", (event) => {
    const { begin_ns, live, camera } = /** @type {CustomEvent} */ (event).detail;
    if (!recording && !viewer.sound)
      live
        ? offerSound(null, { beginMs: 0, camera })
        : offerSound(`${place}/sound`, { beginMs: begin_ns / 1e6, camera });
  });
  viewer.addEventListener("moments", (event) => timeline.holds(/** @type {CustomEvent} */ (event).detail.moments));
  viewer.addEventListener("drawn", (event) => {
    const { ms, all } = /** @type {CustomEvent} */ (event).detail;
    quality.frame(ms, all);
    if (quality.isTooSlow && !told && !recording) {
      told = true;
      toast("This device is slow at drawing this scene", SLOW_MS, {
        label: "Let the server draw",
        act: () => drawThere(true),
      });
    }
  });
  viewer.addEventListener("graphics", refresh);
  const heartbeat = setInterval(() => {
    quality.tick();
    if (viewer.status?.phase === "reconnecting") refresh();
    delay.show(viewer.status, viewer.painter.isLost);
    if (!element("stats").hidden) fillStatistics(element("stats"), viewer, rates, delay.seconds);
    canvas.ariaDescription = describe(viewer, element("t-time").textContent ?? "");
  }, 500);
  let lastOutside = -1;
  viewer.addEventListener("frame", () => {
    const far = viewer.presenting ? 0 : viewer.stance.outside;
    if (far === lastOutside) return;
    lastOutside = far;
    // What nobody filmed, in the scene's own colours; a filter of the canvas itself would let the page shine through at its border.
    element("haze").style.backdropFilter = far > 0 ? `blur(${(MAX_BLUR_PX * far).toFixed(1)}px)` : "";
    button("b-back").hidden = far < BACK_AT;
  });
  button("b-back").onclick = () => goHome();
  const goHome = () => viewer.stance.home && viewer.stance.moveTo(viewer.stance.home);
  /** @param {number} index */
  const goTo = (index) => {
    const camera = viewer.scene?.cameras[index];
    if (!camera) return;
    viewer.stance.standAt(camera);
    toast(camera.name);
    if (viewer.pictured.includes(camera.name)) showPicture(camera.name);
  };
  /** @param {string} name */
  const showPicture = (name) =>
    showSource(
      name,
      `${place}/cameras/${encodeURIComponent(name)}.jpg`,
      token,
      () => viewer.running && !timeline.stands,
    );
  const fullScreen = () => {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen?.().catch(() => toast("Full screen is not allowed here"));
  };
  /** @param {"vr" | "ar"} kind */
  const putOn = async (kind) => {
    if (button(`b-${kind}`).hidden || viewer.presenting) return;
    const { enter } = await import("../view/webxr.js");
    await enter(viewer, `immersive-${kind}`).catch((error) => toast(`The headset cannot be used: ${error.message}`));
  };
  /** Let the server draw from now on, or no longer. @param {boolean} thin */
  const drawThere = (thin) => {
    const swap = new URL(location.href);
    swap.searchParams.set("thin", thin ? "1" : "0");
    swap.searchParams.set("camera", toText(viewer.stance.pose));
    location.assign(swap);
  };
  const statistics = () => {
    const panel = element("stats");
    panel.hidden = !panel.hidden;
    button("b-stats").setAttribute("aria-pressed", String(!panel.hidden));
    if (!panel.hidden) fillStatistics(panel, viewer, rates, delay.seconds);
  };
  const help = () => /** @type {HTMLDialogElement} */ (element("help")).showModal();

  button("b-home").onclick = goHome;
  button("b-fly").onclick = () => flight.toggle();
  button("b-shot").onclick = () => savePicture(viewer);
  button("b-full").onclick = fullScreen;
  button("b-float").hidden = !("documentPictureInPicture" in window) || window.parent !== window; // frames may not
  button("b-float").onclick = async () => {
    const { toggleFloating } = await import("./floating.js");
    toggleFloating(viewer, (floats) => {
      button("b-float").setAttribute("aria-pressed", String(floats));
      if (floats) toast("The picture is in the small window");
    }).catch((error) => toast(`There is no small window: ${error.message}`));
  };
  for (const kind of /** @type {("vr" | "ar")[]} */ (["vr", "ar"])) {
    button(`b-${kind}`).onclick = () => putOn(kind);
    if (!viewer.thin)
      navigator.xr?.isSessionSupported(`immersive-${kind}`).then(
        (can) => (button(`b-${kind}`).hidden = !can),
        () => {},
      );
  }
  button("b-stats").onclick = statistics;
  button("b-help").onclick = help;
  button("stream-name").onclick = () => showStreams(options);
  button("card-button").onclick = () => {
    const phase = viewer.status?.phase;
    if (viewer.painter.isLost && !recording) drawThere(true);
    else if (phase === "reconnecting") viewer.tell({ type: "hurry" });
    else if (phase === "missing") showStreams(options);
    else if (phase === "denied") enterToken();
    else location.reload();
  };
  element("card-token").onkeydown = ({ key }) => {
    if (key === "Enter") enterToken();
  };
  const rig = new Rig(viewer, goTo);
  const cameraMenu = element("camera-menu");
  attachMenu(button("b-cameras"), cameraMenu, () => {
    const cameras = viewer.scene?.cameras ?? [];
    cameraMenu.replaceChildren(
      menuItem(rig.shown ? "Hide the rig" : "Show the rig", "", null, () => {
        rig.toggle();
        button("b-cameras").click();
      }),
      document.createElement("hr"),
      ...cameras.map((camera, i) => menuItem(camera.name, i < 9 ? String(i + 1) : "", null, () => goTo(i))),
    );
  });
  const qualityMenu = element("quality-menu");
  attachMenu(button("b-quality"), qualityMenu, () => {
    const note = Object.assign(document.createElement("p"), { textContent: quality.explain() });
    qualityMenu.replaceChildren(
      note,
      ...QUALITIES.map(({ name, label, note: small }) =>
        menuItem(label, small, quality.name === name, () => {
          quality.choose(name);
          button("b-quality").click();
        }),
      ),
    );
    if (!viewer.thin) qualityMenu.append(...backgroundItems(viewer), ...lensItems(viewer));
    if (!recording)
      qualityMenu.append(menuItem("Server draws", "slow devices", viewer.thin, () => drawThere(!viewer.thin)));
  });

  /** @type {Record<string, () => unknown>} */
  const keys = {
    " ": () => timeline.toggle(),
    ",": () => timeline.step(-1),
    ".": () => timeline.step(1),
    home: () => timeline.begin(),
    j: () => timeline.skip(-10),
    k: () => timeline.toggle(),
    l: () => timeline.skip(10),
    end: () => timeline.live(),
    m: () => timeline.position && timeline.marks.toggle(timeline.position),
    r: goHome,
    f: fullScreen,
    t: () => flight.toggle(),
    g: () => together.toggle(),
    v: () => putOn("vr"),
    p: () => savePicture(viewer),
    y: () => copyMoment(viewer),
    i: statistics,
    h: help,
    "?": help,
    c: () => button("b-cameras").click(),
    b: () => button("b-path").click(),
  };
  window.addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest("dialog, .menu, #card-token")) return;
    if (event.key === " " && target.closest("button")) return;
    const key = event.key.toLowerCase();
    if (target.closest("input") && OF_SLIDERS.has(key)) return;
    if (keys[key]) {
      event.preventDefault();
      keys[key]();
    } else if (/^[1-9]$/.test(key)) goTo(Number(key) - 1);
  });

  /** @type {import("./paths.js").Paths | null} loaded when it is asked for */
  let paths = null;
  const loadPaths = async () => (paths ??= new (await import("./paths.js")).Paths(viewer, timeline));
  button("b-path").addEventListener("click", async () => {
    if (paths) return;
    await loadPaths();
    button("b-path").click(); // opens: it listens from now on
  });
  if (options.has("path")) loadPaths();

  controls.mayDrift = () =>
    quality.step === 0 &&
    together.role === "apart" &&
    !flight.stop &&
    !paths?.stop &&
    MOVING.includes(viewer.status?.phase ?? "");
  if (
    !viewer.thin &&
    !options.has("camera") &&
    options.get("sway") !== "0" &&
    (!viewer.painter.software || options.get("sway") === "1")
  ) {
    viewer.addEventListener("picture", () => setTimeout(() => quality.step === 0 && flight.open(), OPENING_AFTER_MS), {
      once: true,
    });
  }
  attachPhone(viewer);
  const wake = hideWhenIdle(
    () => viewer.picture !== null && !timeline.stands && !document.querySelector(".sheet, .menu:not([hidden])"),
  );
  viewer.addEventListener("picture", wake, { once: true });
  window.addEventListener("pagehide", () => clearInterval(heartbeat));

  const pose = fromText(options.get("camera"));
  if (pose) viewer.stance.steer(pose);
  element("stage").toggleAttribute("data-thin", viewer.thin);
  const slow = () => toast("Drawn in software: turn on hardware acceleration for a smooth picture", 6000);
  if (viewer.painter.software) viewer.addEventListener("picture", slow, { once: true });

  const wishes = quality.wishes();
  /** @type {import("./moments.js").Source} */
  const source = { viewer, address: () => null, token };
  attachDrop(async (file) => {
    if (/\.json$/i.test(file.name)) return (await loadPaths()).open(await file.text());
    if (viewer.thin) return toast("Files play only where this page draws");
    recording = URL.createObjectURL(file);
    viewer.sound?.close();
    viewer.sound = null;
    source.address = () => recording;
    document.title = `${file.name} · streamlod`;
    viewer.forget();
    timeline.forget();
    viewer.tell({ type: "connect", live: null, file: recording, token: null, wishes });
  });
  viewer.paint(colourOf(options.get("background")));
  viewer.focus(blurOf(options.get("blur")));
  /** @param {(epoch?: number) => string | null} address */
  const offer = (address) => {
    Object.assign(source, { address });
    attachSharing(source, timeline);
    if (!viewer.thin)
      timeline.scrub.addEventListener(
        "pointermove",
        async (event) => (await import("./moments.js")).attachPeek(source, timeline)(event),
        { once: true },
      );
  };
  if (recording) {
    const url = new URL(recording, location.href).href;
    offer(() => url);
    const sound = options.get("sound");
    if (sound) offerSound(new URL(sound, location.href).href, null);
    document.title = `${decodeURIComponent(url.split(/[?#]/)[0].split("/").pop() ?? "")} · streamlod`;
    viewer.tell({ type: "connect", live: null, file: url, token: null, wishes });
    return;
  }
  const stream = await chooseStream(options);
  if (recording) return; // a file was dropped meanwhile
  place = serverPath(`v1/streams/${encodeURIComponent(stream)}`);
  offer((epoch) => {
    if (!viewer.status?.window) return null;
    return viewer.status.source === "recording"
      ? `${place}/recording`
      : `${place}/bitstream${epoch === undefined ? "" : `?epoch=${epoch}`}`;
  });
  followPast(place, token, viewer, timeline);
  countWatchers(options, stream, viewer);
  viewer.tell({
    type: "connect",
    live: liveAddress(stream),
    file: isShared ? null : `${place}/recording`,
    token,
    wishes,
  });
}

/** Begin anew with the token that was entered. */
function enterToken() {
  const field = /** @type {HTMLInputElement} */ (element("card-token")),
    given = field.value.trim();
  if (!given) return field.focus();
  const address = new URL(location.href);
  address.searchParams.set("token", given);
  location.assign(address);
}

const viewer = await createViewer();
if (viewer) await start(viewer);
