/** Coding 0: columns of i32 under raw deflate, inflated by the browser (codec/FORMAT.md 6.1). */

import { LIMITS, must, Reader } from "./packet.js";

const GAIN = 1040; // deflate expands to at most 1032 times its length

/**
 * @param {Uint8Array} chunk - from the coding byte on
 * @param {number} channels
 * @param {number} most - rows that are possible here
 * @returns {Promise<{ rows: number, columns: Int32Array }>} column after column
 */
export async function inflateColumns(chunk, channels, most) {
  const reader = new Reader(chunk, "corrupt_chunk");
  reader.u8();
  const rows = reader.u32();
  must(rows <= LIMITS.anchors, "limit_exceeded", `a chunk announces ${rows} rows`);
  must(rows <= most, "corrupt_chunk", `a chunk announces ${rows} rows where ${most} are possible`);
  must(4 * channels * rows <= GAIN * chunk.length, "corrupt_chunk", "a chunk announces more than it can hold");
  const columns = new Int32Array(rows * channels);
  await inflate(reader.rest(), new Uint8Array(columns.buffer));
  return { rows, columns };
}

/** Inflate `bytes` so that they fill `out` exactly. @type {(bytes: Uint8Array, out: Uint8Array) => Promise<void>} */
async function inflate(bytes, out) {
  const stream = new DecompressionStream("deflate-raw");
  const writer = stream.writable.getWriter();
  const written = Promise.all([writer.write(/** @type {any} */ (bytes)), writer.close()]).then(() => true, () => false);
  const output = stream.readable.getReader();
  let at = 0, fits = true;
  try {
    for (;;) {
      const { done, value } = await output.read();
      if (done) break;
      fits = at + value.length <= out.length;
      if (!fits) break;
      out.set(value, at);
      at += value.length;
    }
  } catch {
    fits = false;
  }
  if (!fits) output.cancel().catch(() => undefined);
  fits = (fits && (await written)) && at === out.length;
  must(fits, "corrupt_chunk", "a deflated chunk does not inflate to what it announces");
}
