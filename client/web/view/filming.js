/** Films: takes a video's pictures as they come, encodes those for which there is room, and hands them to the link. */

import { eachPicture, holdStill, part } from "./device.js";
import { createEncoder } from "./encoding.js";

/** @typedef {import("../stream/push.js").PushLink} PushLink */
/** @typedef {import("../stream/push.js").WantedCamera} WantedCamera */

const SETTLE_MS = 2500; // in which a camera finds its exposure and focus, before these are held

export class Filming {
  /**
   * @param {PushLink} link @param {HTMLVideoElement} video - plays `media` @param {MediaStream} media
   * @param {string} name - of the camera in the stream @param {boolean} jpeg - rather than H.264 @param {() => void} changed
   */
  constructor(link, video, media, name, jpeg, changed) {
    this.link = link;
    this.video = video;
    this.name = name;
    this.jpeg = jpeg;
    this.changed = changed;
    this.track = media.getVideoTracks()[0];
    this.canvas = document.createElement("canvas"); // pictures are sent as they lie in it: upright, of the size that is wanted
    this.pen = this.canvas.getContext("2d", { alpha: false });
    /** @type {import("./device.js").Held | null} */
    this.held = null;
    this.over = false;
    this.turned = false; // against what is wanted
    this.newest = performance.now(); // picture
    this.filmed = this.sent = this.dropped = 0;
    this.connection = 0; // of the newest picture
    /** @type {Awaited<ReturnType<typeof createEncoder>> | null} */
    this.encoder = null;
    this.size = ""; // for which the encoder was made
    /** @type {WakeLockSentinel | null} */
    this.awake = null;
    this.end = eachPicture(video, (takenMs) => this.#picture(takenMs));
    this.settling = window.setTimeout(() => this.hold(true), SETTLE_MS);
    this.stayAwake();
  }

  /** Hold exposure, focus and colour, or let them go. @param {boolean} still */
  async hold(still) {
    clearTimeout(this.settling);
    this.held = await holdStill(this.track, still);
    this.changed();
  }

  /** Keep the screen on; the browser forgets that whenever the page is hidden. */
  async stayAwake() {
    this.awake = (await navigator.wakeLock?.request("screen").catch(() => null)) ?? null;
    if (this.over) this.awake?.release();
  }

  stop() {
    this.over = true;
    this.end();
    clearTimeout(this.settling);
    this.track.stop();
    this.encoder?.close();
    this.awake?.release();
  }

  /** @param {number} takenMs */
  #picture(takenMs) {
    this.filmed++;
    this.newest = performance.now();
    const { link, video, canvas } = this,
      wanted = link.cameras.find(({ name }) => name === this.name);
    if (!wanted || link.state !== "open") return;
    const from = part({ width: video.videoWidth, height: video.videoHeight }, wanted);
    if (this.turned !== !from) {
      this.turned = !from;
      this.changed();
    }
    if (!from) return;
    const encoder = this.#encoderFor(wanted);
    if (!encoder?.hasRoom || !link.hasRoom) {
      this.dropped++;
      return;
    }
    if (this.connection !== link.connections) encoder.begin();
    this.connection = link.connections;
    this.pen?.drawImage(video, from.x, from.y, from.width, from.height, 0, 0, canvas.width, canvas.height);
    encoder.encode(canvas, takenMs);
  }

  /** The encoder for pictures of the size that is wanted; null while it is made. @param {WantedCamera} wanted */
  #encoderFor({ width, height }) {
    const size = `${width}×${height}`,
      { link } = this;
    if (this.encoder?.failed) this.jpeg = true;
    else if (this.size === size) return this.encoder;
    this.size = size;
    this.encoder?.close();
    this.encoder = null;
    Object.assign(this.canvas, { width, height });
    createEncoder({ width, height }, link.fps, this.jpeg, (takenMs, codec, picture) => {
      // of an earlier connection, it may refer to pictures that are lost
      if (this.over || this.size !== size || this.connection !== link.connections) return;
      this.sent++;
      link.send(this.name, takenMs, codec, picture);
    }).then((made) => {
      if (this.over || this.size !== size) made.close();
      else this.encoder = made;
    });
    return null;
  }
}
