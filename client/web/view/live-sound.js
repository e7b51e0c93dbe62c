/** Live sound: pieces of MP4 that come on the socket of the pictures, put together for an audio element. */

const KEPT_SECONDS = 60,
  SPARE_SECONDS = 10; // of what was heard
const TYPE = 'audio/mp4; codecs="opus"';

export class LiveSound {
  /** @param {import("./viewer.js").Viewer} viewer @param {AbortSignal} signal - ends it */
  constructor(viewer, signal) {
    this.viewer = viewer;
    /** @type {ArrayBuffer[]} */
    this.waiting = [];
    /** @type {SourceBuffer | null} */
    this.buffer = null;
    /** @type {HTMLAudioElement | null} */
    this.audio = null;
    const take = (/** @type {Event} */ event) => {
      this.waiting.push(/** @type {CustomEvent} */ (event).detail.piece);
      this.#append();
    };
    viewer.addEventListener("heard", take, { signal });
  }

  /**
   * Give an element its source.
   * @param {HTMLAudioElement} audio @throws {Error} where the browser has none for such sound
   */
  open(audio) {
    /** @type {typeof MediaSource} */
    const Source = /** @type {any} */ (window).ManagedMediaSource ?? MediaSource; // the former on iPhones
    if (!Source.isTypeSupported(TYPE)) throw new Error("no Opus in this browser");
    const source = new Source();
    this.audio = audio;
    audio.disableRemotePlayback = true; // iPhones want that
    audio.src = URL.createObjectURL(source);
    source.onsourceopen = () => {
      this.buffer = source.addSourceBuffer(TYPE);
      this.buffer.onupdateend = () => this.#append();
      this.#append();
    };
  }

  /** Ask for sound, or for none any more. @param {boolean} on */
  turn(on) {
    if (!on) this.waiting.length = 0;
    this.viewer.tell({ type: "listen", on });
  }

  /** One thing at a time, as the buffer wants it: forget what is old, or take the next piece. */
  #append() {
    const { audio, buffer, waiting } = this;
    if (!audio || !buffer || buffer.updating || !waiting.length) return;
    const begin = buffer.buffered.length ? buffer.buffered.start(0) : Infinity,
      old = audio.currentTime - KEPT_SECONDS;
    if (begin < old - SPARE_SECONDS) buffer.remove(begin, old);
    else buffer.appendBuffer(/** @type {ArrayBuffer} */ (waiting.shift()));
  }
}
