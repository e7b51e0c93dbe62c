/** Which stream to watch. */

import { button, element } from "./page.js";
import { show } from "./status.js";

/** @typedef {{ id: string, name: string, source: string, state: string, viewers: number, camera_pictures?: string[], sound?: { begin_ns: number, live?: boolean, camera?: string | null } | null }} Stream */

/**
 * An address of the server that the page is from, which may stand under a path of a proxy.
 * @param {string} path - without a slash at its begin
 */
export const serverPath = (path) => new URL(path, new URL(".", location.href)).href;

/**
 * @param {URLSearchParams} options
 * @returns {Promise<{ status: number, items: Stream[] }>} without items where the server does not say; status 503 where it does not answer
 */
async function askStreams(options) {
  const token = options.get("token");
  try {
    const answer = await fetch(serverPath("v1/streams"), {
      headers: token ? { Authorization: `Bearer ${token}` } : {},
    });
    return { status: answer.status, items: answer.ok ? (await answer.json()).items : [] };
  } catch {
    return { status: 503, items: [] };
  }
}

/** @param {URLSearchParams} options @returns {Promise<Stream[]>} */
const fetchStreams = async (options) => (await askStreams(options)).items;

/**
 * The list, however long that takes: a server that does not answer is asked again, ever more slowly.
 * @param {URLSearchParams} options
 * @returns {Promise<Stream[]>}
 */
async function awaitStreams(options) {
  for (let attempt = 0; ; attempt++) {
    const { status, items } = await askStreams(options);
    if (status < 500) return items;
    const wait = Math.min(FIRST_WAIT_MS * 2 ** Math.max(attempt - 3, 0), MAX_WAIT_MS);
    const text = `Trying again in ${Math.ceil(wait / 1000)} s.`;
    show({ chip: "Connecting", tone: "busy", card: { title: "The server does not answer", text, spinner: true } });
    await new Promise((resolve) => setTimeout(resolve, wait));
  }
}

/**
 * The stream that is shown where none is named: what cameras film now before what else is shown now, and that before
 * all others.
 * @param {Stream[]} streams
 * @returns {Stream | undefined}
 */
export function foremost(streams) {
  const live = streams.filter(({ state }) => state === "live");
  return live.find(({ source }) => source === "cameras") ?? live[0] ?? streams[0];
}

/**
 * The stream the address names, or the server's foremost one.
 * @param {URLSearchParams} options
 * @returns {Promise<string>}
 */
export async function chooseStream(options) {
  const named = options.get("stream"),
    listed = named === null ? awaitStreams(options) : fetchStreams(options);
  const chosen = named ?? foremost(await listed)?.id ?? "main"; // a named one need not wait
  listed.then((streams) => {
    const label = button("stream-name");
    label.value = chosen;
    label.textContent = streams.find(({ id }) => id === chosen)?.name ?? chosen;
    document.title = `${label.textContent} · streamlod`;
    label.hidden = streams.length < 2;
  });
  return chosen;
}

const FIRST_WAIT_MS = 500,
  MAX_WAIT_MS = 15_000; // between two attempts, as of the connection
const COUNT_MS = 10_000;

/**
 * Ask how many watch a stream, and for its cameras' pictures, while `viewer` watches.
 * @param {URLSearchParams} options
 * @param {string} stream
 * @param {import("../view/viewer.js").Viewer} viewer
 */
export async function countWatchers(options, stream, viewer) {
  for (; viewer.running; await new Promise((resolve) => setTimeout(resolve, COUNT_MS))) {
    if (document.hidden || ["reconnecting", "denied"].includes(viewer.status?.phase ?? "")) continue;
    const { status, items } = await askStreams(options),
      told = items.find(({ id }) => id === stream);
    if (status === 401) return; // a server counts who comes with a bad token; another one begins the page anew
    if (told && ["deleted", "missing"].includes(viewer.status?.phase ?? "")) location.reload(); // it was made again
    viewer.watchers = told?.viewers ?? null;
    viewer.pictured = told?.camera_pictures ?? [];
    if (told?.sound) viewer.dispatchEvent(new CustomEvent("sound", { detail: told.sound }));
    element("status-viewers").textContent = (viewer.watchers ?? 0) > 1 ? `${viewer.watchers} watching` : "";
  }
}

/** @type {(stream: string) => string} */
export function liveAddress(stream) {
  return serverPath(`v1/streams/${encodeURIComponent(stream)}/live`).replace("http", "ws");
}

/** The list, in a dialog. @param {URLSearchParams} options */
export async function showStreams(options) {
  const streams = await fetchStreams(options);
  const items = streams.map(({ id, name, state, viewers }) => {
    const link = document.createElement("a");
    const address = new URL(location.href);
    address.searchParams.set("stream", id);
    address.searchParams.delete("camera");
    address.searchParams.delete("t");
    link.href = address.href;
    link.setAttribute("aria-current", String(id === button("stream-name").value));
    const note = document.createElement("small");
    note.textContent = `${state}, ${viewers} watching`;
    link.append(name, note);
    if (!options.has("token")) {
      // images carry none
      const poster = Object.assign(new Image(), {
        src: serverPath(`v1/streams/${encodeURIComponent(id)}/poster.jpg`),
        alt: "",
        loading: "lazy",
      });
      poster.onerror = () => poster.remove();
      link.prepend(poster);
    }
    const item = document.createElement("li");
    item.append(link);
    return item;
  });
  if (!items.length)
    items.push(Object.assign(document.createElement("li"), { textContent: "There is no stream now." }));
  element("stream-list").replaceChildren(...items);
  /** @type {HTMLDialogElement} */ (element("streams")).showModal();
}
