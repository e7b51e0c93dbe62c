/** Coding 0: raw deflate (codec/FORMAT.md 6.1, RFC 1951). The browser's is not strict about the end. */

import { must } from "./packet.js";

/** @typedef {import("./packet.js").Reader} Reader */

const MAX_BITS = 15;
const LENGTH_ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/** The number of rows that a chunk announces behind its coding. @type {(reader: Reader) => number} */
export function rowCount(reader) {
  const rows = reader.u32();
  must(rows > 0);
  return rows;
}

/**
 * The rest of a chunk of coding 0, column after column; `rows` has been found acceptable.
 * @type {(reader: Reader, rows: number, channels: number) => Int32Array}
 */
export function inflateColumns(reader, rows, channels) {
  const columns = new Int32Array(rows * channels);
  inflate(reader.rest(), new Uint8Array(columns.buffer));
  return columns;
}

/**
 * Base values and extra bits of lengths and distances.
 * @type {(first: number, extra: (i: number) => number, count: number) => { base: Uint16Array, extra: Uint8Array }}
 */
function ranges(first, extra, count) {
  const base = new Uint16Array(count),
    bits = new Uint8Array(count);
  for (let i = 0, at = first; i < count; at += 2 ** extra(i), i++) {
    base[i] = at;
    bits[i] = extra(i);
  }
  return { base, extra: bits };
}

const LENGTHS = ranges(3, (i) => (i < 8 ? 0 : (i >> 2) - 1), 29);
[LENGTHS.base[28], LENGTHS.extra[28]] = [258, 0];
const DISTANCES = ranges(1, (i) => (i < 4 ? 0 : (i >> 1) - 1), 30);

/**
 * A lookup by the next bits: symbol << 4 | code length, 0 where there is no code.
 * @typedef {{ table: Uint16Array, bits: number }} Codes
 */

/** @type {(lengths: Uint8Array) => Codes} */
function codesOf(lengths) {
  const bits = Math.max(1, ...lengths);
  const counts = new Uint16Array(MAX_BITS + 1),
    next = new Uint16Array(MAX_BITS + 2);
  for (const length of lengths) if (length) counts[length]++;
  let space = 1;
  for (let n = 1; n <= bits; n++) {
    space = 2 * space - counts[n];
    must(space >= 0);
    next[n + 1] = (next[n] + counts[n]) << 1;
  }
  const table = new Uint16Array(1 << bits);
  lengths.forEach((length, symbol) => {
    if (!length) return;
    let code = next[length]++,
      reversed = 0;
    for (let i = 0; i < length; i++, code >>= 1) reversed = (reversed << 1) | (code & 1);
    for (let i = reversed; i < table.length; i += 1 << length) table[i] = (symbol << 4) | length;
  });
  return { table, bits };
}

const FIXED = {
  literals: codesOf(Uint8Array.from({ length: 288 }, (_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8))),
  distances: codesOf(new Uint8Array(30).fill(5)),
};

/** Inflate all of `bytes` to all of `out`. @type {(bytes: Uint8Array, out: Uint8Array) => void} */
function inflate(bytes, out) {
  let at = 0,
    held = 0,
    count = 0,
    written = 0;
  /** @type {(n: number) => number} peek at n <= 15 bits; beyond the end there are zeros */
  const peek = (n) => {
    while (count < n) {
      held |= (at < bytes.length ? bytes[at] : 0) << count;
      at++;
      count += 8;
    }
    return held & ((1 << n) - 1);
  };
  /** @type {(n: number) => void} */
  const drop = (n) => {
    held >>>= n;
    count -= n;
    must(at - (count >> 3) <= bytes.length);
  };
  /** @type {(n: number) => number} */
  const take = (n) => {
    const value = peek(n);
    drop(n);
    return value;
  };
  /** @type {(codes: Codes) => number} */
  const symbol = ({ table, bits }) => {
    const entry = table[peek(bits)];
    must(entry);
    drop(entry & 15);
    return entry >> 4;
  };
  const stored = () => {
    drop(count & 7);
    const size = take(8) | (take(8) << 8),
      check = take(8) | (take(8) << 8);
    at -= count >> 3;
    held = count = 0;
    const fits = (size ^ check) === 0xffff && at + size <= bytes.length && written + size <= out.length;
    must(fits);
    out.set(bytes.subarray(at, at + size), written);
    at += size;
    written += size;
  };
  const dynamic = () => {
    const literals = take(5) + 257,
      distances = take(5) + 1,
      coded = take(4) + 4;
    must(literals <= 286 && distances <= 30);
    const order = new Uint8Array(19),
      lengths = new Uint8Array(literals + distances);
    for (let i = 0; i < coded; i++) order[LENGTH_ORDER[i]] = take(3);
    const codes = codesOf(order);
    for (let i = 0; i < lengths.length;) {
      const s = symbol(codes);
      if (s < 16) lengths[i++] = s;
      else {
        const times = s === 16 ? 3 + take(2) : s === 17 ? 3 + take(3) : 11 + take(7);
        must((s > 16 || i > 0) && i + times <= lengths.length);
        lengths.fill(s === 16 ? lengths[i - 1] : 0, i, i + times);
        i += times;
      }
    }
    return { literals: codesOf(lengths.subarray(0, literals)), distances: codesOf(lengths.subarray(literals)) };
  };
  /** @param {{ literals: Codes, distances: Codes }} codes */
  const block = ({ literals, distances }) => {
    for (;;) {
      const s = symbol(literals);
      if (s === 256) return;
      if (s < 256) {
        must(written < out.length);
        out[written++] = s;
        continue;
      }
      must(s <= 285);
      const length = LENGTHS.base[s - 257] + take(LENGTHS.extra[s - 257]);
      const d = symbol(distances);
      const distance = DISTANCES.base[d] + take(DISTANCES.extra[d]);
      must(distance <= written && written + length <= out.length);
      for (const end = written + length; written < end; written++) out[written] = out[written - distance];
    }
  };
  for (let last = 0; !last;) {
    last = take(1);
    const type = take(2);
    must(type < 3);
    if (type === 0) stored();
    else block(type === 1 ? FIXED : dynamic());
  }
  must(written === out.length && at - (count >> 3) === bytes.length);
}
