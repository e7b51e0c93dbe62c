/**
 * `<streamlod-player>`: the viewer as an element of other pages. A plain script, so that any site may load it:
 *
 *     <script src="//HOST/player.js" async></script>
 *     <streamlod-player stream="main" poster="still.jpg" style="width: 640px; aspect-ratio: 16 / 9"></streamlod-player>
 *
 * The server must list the site in its setting `frame_ancestors`.
 */
(() => {
  const base = new URL(".", /** @type {HTMLScriptElement} */ (document.currentScript).src);
  const PARAMETERS = ["stream", "src", "sound", "camera", "t", "quality", "thin", "together", "token"]; // of the page's address
  const METHODS = ["state", "seek", "play", "pause", "step", "loop", "setCamera", "captureFrame", "inspect", "destroy"];
  const VERSION = 1;
  const SILENT = `The player at ${base.host} does not answer: the server is down, or does not allow this page to embed it (setting frame_ancestors).`;
  const READY_MS = 20_000; // in which the page must answer
  const STYLE = `
    :host { display: inline-block; position: relative; width: 640px; aspect-ratio: 16 / 9; background: #0b0e14; }
    iframe, button { position: absolute; inset: 0; width: 100%; height: 100%; border: 0; padding: 0; background: none; }
    button { cursor: pointer; display: grid; place-items: center; }
    img { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: cover; }
    p { position: absolute; inset: 0; margin: auto; height: fit-content; padding: 24px; text-align: center; color: #a6b0bf; font: 14px/1.45 system-ui, sans-serif; }
    span { position: relative; width: 68px; height: 68px; border-radius: 50%; background: rgb(11 14 20 / 70%); color: #fff; display: grid; place-items: center; font-size: 26px; }`;

  class StreamlodPlayer extends HTMLElement {
    /** @type {HTMLIFrameElement | null} */
    #frame = null;
    /** @type {Map<number, { resolve: (value: any) => void, reject: (error: Error) => void }>} */
    #calls = new Map();
    #asked = 0;
    /** @type {Promise<void>} */
    #ready = Promise.resolve();
    #timer = 0;

    static get observedAttributes() {
      return [...PARAMETERS, "controls"];
    }

    /** Attributes may change later: the picture begins anew. */
    attributeChangedCallback() {
      if (this.#frame) this.#frame.replaceWith(this.#open());
    }
    /** @type {(event: MessageEvent) => void} */
    #listen = (event) => this.#hear(event);

    connectedCallback() {
      window.addEventListener("message", this.#listen);
      const root = this.shadowRoot ?? this.attachShadow({ mode: "open" });
      const style = Object.assign(document.createElement("style"), { textContent: STYLE });
      const poster = this.getAttribute("poster");
      const slot = document.createElement("slot"); // what a page puts into the element lies over the picture
      if (poster === null) return root.replaceChildren(style, this.#open(), slot);
      const cover = document.createElement("button");
      cover.setAttribute("aria-label", "Play");
      cover.append(
        Object.assign(new Image(), { src: poster, alt: "" }),
        Object.assign(document.createElement("span"), { textContent: "▶" }),
      );
      cover.onclick = () => root.replaceChildren(style, this.#open(), slot);
      root.replaceChildren(style, cover);
    }

    disconnectedCallback() {
      window.removeEventListener("message", this.#listen);
      for (const { reject } of this.#calls.values()) reject(new Error("the player was removed"));
      this.#calls.clear();
      clearTimeout(this.#timer);
      this.#frame = null;
    }

    #open() {
      const address = new URL("index.html", base);
      address.searchParams.set("embed", "1");
      if (this.getAttribute("controls") === "no") address.searchParams.set("ui", "0");
      for (const name of PARAMETERS) {
        const value = this.getAttribute(name);
        if (value !== null) address.searchParams.set(name, value);
      }
      const frame = document.createElement("iframe");
      frame.title = this.getAttribute("title") ?? "Free-viewpoint video";
      frame.allow = "fullscreen; xr-spatial-tracking; clipboard-write; screen-wake-lock";
      frame.src = address.href;
      // The page says "ready" when it takes calls; those made before wait for it. A page that does not come (the
      // server is down, or does not list this site in `frame_ancestors`) says nothing at all.
      clearTimeout(this.#timer);
      this.#ready = new Promise((resolve, reject) => {
        this.addEventListener("ready", () => resolve(), { once: true });
        this.#timer = setTimeout(() => reject(new Error(SILENT)), READY_MS);
      });
      this.#ready.then(
        () => clearTimeout(this.#timer),
        (error) => this.#fail(error),
      );
      return (this.#frame = frame);
    }

    /** @param {Error} error */
    #fail(error) {
      if (!this.#frame) return;
      this.#frame.replaceWith(Object.assign(document.createElement("p"), { textContent: error.message }));
      this.#frame = null;
      this.dispatchEvent(new ErrorEvent("error", { message: error.message, error }));
    }

    /** @param {MessageEvent} event */
    #hear({ data, source }) {
      if (!this.#frame || source !== this.#frame.contentWindow || data?.streamlod === undefined) return;
      if (data.streamlod === "event") {
        this.dispatchEvent(new CustomEvent(data.event, { detail: data.state }));
        return;
      }
      const call = this.#calls.get(data.id);
      this.#calls.delete(data.id);
      if (data.error !== undefined) call?.reject(new Error(data.error));
      else call?.resolve(data.result);
    }

    /** @param {string} method @param {any[]} all @returns {Promise<any>} rejected with the page's own words */
    async call(method, ...all) {
      if (!this.#frame) throw new Error("the player is not open yet");
      await this.#ready;
      const id = ++this.#asked;
      return new Promise((resolve, reject) => {
        this.#calls.set(id, { resolve, reject });
        this.#frame?.contentWindow?.postMessage(
          { streamlod: method, version: VERSION, arguments: all, id },
          base.origin,
        );
      });
    }
  }
  for (const method of METHODS) {
    Object.defineProperty(StreamlodPlayer.prototype, method, {
      /** @param {any[]} all */
      value(...all) {
        return this.call(method, ...all);
      },
    });
  }
  if (!customElements.get("streamlod-player")) customElements.define("streamlod-player", StreamlodPlayer);
})();
