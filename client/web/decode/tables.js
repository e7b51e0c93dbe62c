/** Constants of the entropy code, codec/FORMAT.md sections 6.2 and 12. */

const MAGNITUDES = 790;

const SMALL = new Uint8Array(MAGNITUDES);
for (let k = 0; k < 30; k++) SMALL.subarray(Math.round(2 ** (k / 4 + 2.125))).forEach((_, e, rest) => rest[e]++);

/** The table bin of a magnitude in 1/256. @type {(e: number) => number} */
export function bin(e) {
  let k = 0;
  while (e >= MAGNITUDES) {
    e = Math.floor(e / 2);
    k += 4;
  }
  return k + SMALL[e];
}

const SYMBOLS = 17,
  BINS = 31;

/**
 * Frequencies in each of the 31 bins: of symbols 1 and 2, 3 and 4, ... 13 and 14, which are the same, of 15 and of 16.
 * That of 0 makes the sum 4096.
 */
const FREQUENCIES = `20 1 1 1 1 1 1 1 1
40 1 1 1 1 1 1 1 1
68 4 1 1 1 1 1 1 1
79 5 1 1 1 1 1 1 1
118 10 1 1 1 1 1 1 1
126 3 1 1 1 1 1 1 1
123 7 1 1 1 1 1 1 1
125 6 1 1 1 1 1 1 1
132 7 1 1 1 1 1 1 1
151 8 2 1 1 1 1 1 1
173 14 1 1 1 1 1 1 1
187 13 2 1 1 1 1 1 1
205 17 4 1 1 1 1 1 1
223 20 4 1 1 1 1 1 1
256 24 5 1 1 1 1 1 1
303 33 7 2 1 1 1 1 1
356 41 9 3 1 1 1 1 1
440 56 12 4 1 1 1 1 1
551 60 14 5 2 1 1 1 1
636 70 20 7 2 1 1 1 2
715 93 20 9 3 1 1 1 1
748 130 34 14 6 2 1 1 3
785 168 45 15 8 3 2 4 6
768 204 63 26 9 6 3 3 13
761 272 98 35 15 7 2 2 23
715 314 132 61 24 12 9 11 24
669 341 172 79 39 18 11 12 42
659 378 213 116 59 29 13 9 40
608 381 245 154 82 44 28 10 70
554 376 258 177 110 66 41 22 117
505 349 260 197 131 91 59 33 198`;

/** Scales q = 0..191: magnitudes in 1/256. */
export const SCALE = Int32Array.from({ length: 192 }, (_, q) => Math.round(2 ** (q / 8)));

export const FREQUENCY = Uint16Array.from(
  FREQUENCIES.split("\n").flatMap((line) => {
    const row = line
      .split(" ")
      .map(Number)
      .flatMap((n, i) => (i < 7 ? [n, n] : [n]));
    return [row.reduce((rest, n) => rest - n, 4096), ...row];
  }),
);
/** For each bin and slot: symbol << 25 | frequency << 12 | slot - start, so that decoding looks up once. */
export const STEPS = new Uint32Array(BINS * 4096);
for (let b = 0, at = 0; b < BINS; b++) {
  for (let s = 0; s < SYMBOLS; s++) {
    const frequency = FREQUENCY[b * SYMBOLS + s];
    for (let rest = 0; rest < frequency; rest++) STEPS[at++] = (s << 25) | (frequency << 12) | rest;
  }
}
