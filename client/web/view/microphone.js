/** The microphone of this device: its sound in parts of 60 ms with the time at which each began, as Opus or as samples. */

const RATE = 48_000,
  SAMPLES = 2880; // a second; in a part, 60 ms: the longest frame of Opus
const KEPT = 200; // parts from which delays are known
const OPUS_DELAY_MS = 6.5; // a decoder puts out this much later what went in (RFC 7845 section 4.2, at libopus' 312 samples)
const BITS_A_SECOND = 64_000;

/** @typedef {(takenMs: number, codec: "opus" | "pcm", sound: Uint8Array) => void} Output */

export class Microphone {
  /**
   * @param {MediaStream} media - has a track of sound
   * @param {boolean} pcm - rather than Opus
   * @param {Output} output
   */
  constructor(media, pcm, output) {
    this.output = output;
    this.pcm = pcm;
    this.over = false;
    const settings = /** @type {any} */ (media.getAudioTracks()[0].getSettings());
    this.latencyMs = 1000 * (settings.latency ?? 0);
    /** @type {number[]} how long after its place in the sound each of the newest parts came, ms */
    this.delays = [];
    /** @type {AudioEncoder | null} */
    this.encoder = null;
    /** @type {number[]} when what the encoder holds began */
    this.waiting = [];
    this.context = new AudioContext({ sampleRate: RATE });
    this.source = this.context.createMediaStreamSource(media);
    this.ready = this.#open();
  }

  /** @throws {Error} the browser gives no sound */
  async #open() {
    if (!this.pcm) await this.#makeEncoder();
    await this.context.audioWorklet.addModule(new URL("./microphone-worklet.js", import.meta.url));
    if (this.over) return;
    const node = new AudioWorkletNode(this.context, "parts", {
      numberOfOutputs: 0,
      channelCount: 1,
      channelCountMode: "explicit",
      processorOptions: { samples: SAMPLES },
    });
    node.port.onmessage = ({ data }) => this.#take(data.first, data.samples);
    this.source.connect(node);
    await this.context.resume();
  }

  async #makeEncoder() {
    const config = /** @type {AudioEncoderConfig} */ ({
      codec: "opus",
      sampleRate: RATE,
      numberOfChannels: 1,
      bitrate: BITS_A_SECOND,
      opus: { frameDuration: (1e6 * SAMPLES) / RATE },
    });
    if (!("AudioEncoder" in window) || !(await AudioEncoder.isConfigSupported(config).catch(() => null))?.supported)
      return;
    this.encoder = new AudioEncoder({
      output: (chunk) => {
        const bytes = new Uint8Array(chunk.byteLength);
        chunk.copyTo(bytes);
        this.output((this.waiting.shift() ?? NaN) - OPUS_DELAY_MS, "opus", bytes);
      },
      error: () => (this.encoder = null),
    });
    this.encoder.configure(config);
  }

  /** @param {number} first - number of its first sample @param {Float32Array} samples */
  #take(first, samples) {
    if (this.over) return;
    const placeMs = (1000 * first) / RATE;
    this.delays.push(performance.now() - (1000 * samples.length) / RATE - placeMs);
    if (this.delays.length > KEPT) this.delays.shift();
    const takenMs = placeMs + Math.min(...this.delays) - this.latencyMs; // the least delayed one tells most
    if (this.encoder) {
      this.waiting.push(takenMs);
      const part = new AudioData({
        format: "f32",
        sampleRate: RATE,
        numberOfFrames: samples.length,
        numberOfChannels: 1,
        timestamp: Math.round(1000 * placeMs),
        data: /** @type {Float32Array<ArrayBuffer>} */ (samples),
      });
      this.encoder.encode(part);
      part.close();
    } else
      this.output(
        takenMs,
        "pcm",
        new Uint8Array(
          Int16Array.from(samples, (value) => Math.max(-32768, Math.min(32767, Math.round(32768 * value)))).buffer,
        ),
      );
  }

  stop() {
    this.over = true;
    if (this.encoder?.state === "configured") this.encoder.close();
    this.context.close();
  }
}
