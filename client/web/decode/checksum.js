/** CRC-32 (the one of zlib), to check packets and to compare decoders with. */

const TABLES = Array.from({ length: 4 }, () => new Uint32Array(256));
for (let i = 0; i < 256; i++) {
  let c = i;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  TABLES[0][i] = c;
}
for (let t = 1; t < 4; t++) {
  for (let i = 0; i < 256; i++) TABLES[t][i] = TABLES[0][TABLES[t - 1][i] & 255] ^ (TABLES[t - 1][i] >>> 8);
}

/** @type {(bytes: Uint8Array, crc?: number) => number} continues from `crc` */
export function crc32(bytes, crc = 0) {
  const [t0, t1, t2, t3] = TABLES;
  let c = ~crc,
    i = 0;
  for (; i + 4 <= bytes.length; i += 4) {
    c ^= bytes[i] | (bytes[i + 1] << 8) | (bytes[i + 2] << 16) | (bytes[i + 3] << 24);
    c = t3[c & 255] ^ t2[(c >>> 8) & 255] ^ t1[(c >>> 16) & 255] ^ t0[c >>> 24];
  }
  for (; i < bytes.length; i++) c = t0[(c ^ bytes[i]) & 255] ^ (c >>> 8);
  return ~c >>> 0;
}

/** Checksums of what never changes in a row, by the voxels. @type {WeakMap<Int32Array, number>} */
const FIXED = new WeakMap();

/** Everything that a level holds, as AnchorLevel.digest. @type {(level: import("./scene.js").Level) => number} */
export function digest(level) {
  let crc = FIXED.get(level.voxel);
  if (crc === undefined) {
    crc = [level.voxel, level.feature, level.offset, level.scaling, level.extraLevel].reduce(
      (sum, column) => crc32(bytesOf(column), sum),
      0,
    );
    FIXED.set(level.voxel, crc);
  }
  return [level.position, level.latent, level.alive].reduce((sum, column) => crc32(bytesOf(column), sum), crc);
}

/** @type {(a: ArrayBufferView) => Uint8Array} */
const bytesOf = (a) => new Uint8Array(a.buffer, a.byteOffset, a.byteLength);
