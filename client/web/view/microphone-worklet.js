/** Runs where the browser makes sound: hands it on in parts of equal length, each with the number of its first sample. */

/** @typedef {{ port: MessagePort }} Processor */
const scope =
  /** @type {{ AudioWorkletProcessor: new () => Processor, registerProcessor: (name: string, type: unknown) => void, currentFrame: number }} */ (
    /** @type {unknown} */ (globalThis)
  );

class Parts extends scope.AudioWorkletProcessor {
  /** @param {{ processorOptions: { samples: number } }} options */
  constructor({ processorOptions: { samples } }) {
    super();
    this.part = new Float32Array(samples);
    this.filled = 0;
  }

  /** @param {Float32Array[][]} inputs */
  process([[input]]) {
    for (let at = 0; input && at < input.length;) {
      const taken = Math.min(input.length - at, this.part.length - this.filled);
      this.part.set(input.subarray(at, at + taken), this.filled);
      this.filled += taken;
      at += taken;
      if (this.filled < this.part.length) continue;
      this.port.postMessage({ first: scope.currentFrame + at - this.filled, samples: this.part.slice() });
      this.filled = 0;
    }
    return true;
  }
}

scope.registerProcessor("parts", Parts);
