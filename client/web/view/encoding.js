/** Encodes pictures for the ingest websocket: H.264 where the browser does it, else JPEG. */

/** @typedef {{ width: number, height: number }} Size */
/** @typedef {(takenMs: number, codec: "h264" | "jpeg", picture: Uint8Array) => void} Output */

const LEVELS = ["avc1.42E01F", "avc1.42E028", "avc1.42E033"]; // baseline: no picture waits for a later one
const BITS = 0.2; // a pixel
const KEY_EVERY = 60; // pictures
const MAX_WAITING = 2; // pictures in an encoder; a further one would only be late
const JPEG_QUALITY = 0.85;

/**
 * @param {Size} size
 * @param {number} fps
 * @param {boolean} jpeg - rather than H.264
 * @param {Output} output
 * @returns {Promise<H264 | Jpeg>}
 */
export async function createEncoder(size, fps, jpeg, output) {
  const even = size.width % 2 === 0 && size.height % 2 === 0;
  for (const codec of jpeg || !even || !("VideoEncoder" in window) ? [] : LEVELS) {
    /** @type {VideoEncoderConfig} */
    const config = {
      codec,
      ...size,
      framerate: fps,
      bitrate: Math.round(BITS * size.width * size.height * fps),
      latencyMode: "realtime",
      avc: { format: "annexb" },
    };
    const { supported } = await VideoEncoder.isConfigSupported(config).catch(() => ({ supported: false }));
    if (supported) return new H264(config, output);
  }
  return new Jpeg(output);
}

class H264 {
  /** @param {VideoEncoderConfig} config @param {Output} output */
  constructor(config, output) {
    this.codec = "H.264";
    this.failed = false;
    this.count = 0;
    this.encoder = new VideoEncoder({
      output: (chunk) => {
        const bytes = new Uint8Array(chunk.byteLength);
        chunk.copyTo(bytes);
        output(chunk.timestamp / 1000, "h264", bytes);
      },
      error: () => (this.failed = true),
    });
    this.encoder.configure(config);
  }

  get hasRoom() {
    return !this.failed && this.encoder.encodeQueueSize < MAX_WAITING;
  }

  /** The next picture needs none before it. */
  begin() {
    this.count = 0;
  }

  /** @param {HTMLCanvasElement} canvas @param {number} takenMs */
  encode(canvas, takenMs) {
    const frame = new VideoFrame(canvas, { timestamp: Math.round(takenMs * 1000), alpha: "discard" });
    this.encoder.encode(frame, { keyFrame: this.count++ % KEY_EVERY === 0 });
    frame.close();
  }

  close() {
    if (this.encoder.state !== "closed") this.encoder.close();
  }
}

class Jpeg {
  /** @param {Output} output */
  constructor(output) {
    this.codec = "JPEG";
    this.failed = false;
    this.hasRoom = true;
    this.output = output;
  }

  begin() {}

  /** @param {HTMLCanvasElement} canvas @param {number} takenMs */
  encode(canvas, takenMs) {
    this.hasRoom = false;
    canvas.toBlob(
      async (blob) => {
        if (blob) this.output(takenMs, "jpeg", new Uint8Array(await blob.arrayBuffer()));
        this.hasRoom = true;
      },
      "image/jpeg",
      JPEG_QUALITY,
    );
  }

  close() {
    this.output = () => {};
  }
}
