/**
 * When positions were filmed, and the bar made of that: the epochs that can be sought, one after the other, each as
 * long as it was filmed. No page needed.
 */

/** @typedef {import("../stream/session.js").Position} Position */
/** @typedef {{ epoch: number, first: number, last: number }} Span - versions of an epoch that can be sought */
/** @typedef {Span & { begin: number, seconds: number }} Part - where the span begins on the bar, and its length, s */

const MAX_KNOWN = 4096; // positions of an epoch whose times are kept
const GAP_SHARE = 0.015; // of the bar, between two epochs

/** Capture times of positions: known ones, and those between and beyond them at the pace of the known ones. */
export class Times {
  constructor() {
    /** @type {Map<number, { version: number, ms: number }[]>} of each epoch, ascending */
    this.known = new Map();
  }

  /** @param {Position} position @param {number} ms - when it was filmed */
  note({ epoch, version }, ms) {
    const list = this.known.get(epoch) ?? [];
    this.known.set(epoch, list);
    const at = indexOf(list, version);
    if (list[at]?.version === version) list[at].ms = ms;
    else list.splice(at, 0, { version, ms });
    if (list.length > MAX_KNOWN)
      this.known.set(
        epoch,
        list.filter((_, i) => i % 2 === 0 || i === list.length - 1),
      );
  }

  /**
   * When a position was filmed, ms.
   * @param {Position} position
   * @param {number | null} fps - the pace where nothing is known
   */
  at({ epoch, version }, fps) {
    const list = this.known.get(epoch) ?? [];
    const at = indexOf(list, version),
      next = list[at];
    if (next?.version === version) return next.ms;
    const [a, b] = next && at > 0 ? [list[at - 1], next] : [list[0], list[list.length - 1]];
    const pace = a && b.version > a.version ? (b.ms - a.ms) / (b.version - a.version) : 1000 / (fps || 30);
    const from = next ?? b ?? { version: 0, ms: 0 };
    return from.ms + (version - from.version) * pace;
  }

  /**
   * The version of `span` that was filmed last at `ms`.
   * @param {Span} span
   * @param {number} ms
   * @param {number | null} fps
   */
  versionAt({ epoch, first, last }, ms, fps) {
    let low = first,
      high = last;
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (this.at({ epoch, version: middle }, fps) <= ms + 0.5) low = middle;
      else high = middle - 1;
    }
    return low;
  }
}

/**
 * Index of the first entry that is not before `version`.
 * @type {(list: { version: number }[], version: number) => number}
 */
function indexOf(list, version) {
  let low = 0,
    high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle].version < version) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The bar: spans one after the other. */
export class Bar {
  /** @param {Span[]} spans - in order @param {Times} times @param {number | null} fps */
  constructor(spans, times, fps) {
    this.times = times;
    this.fps = fps;
    const lengths = spans.map((span) => {
      const [first, last] = [span.first, span.last].map((version) => times.at({ epoch: span.epoch, version }, fps));
      return Math.max(0, last - first) / 1000;
    });
    const gap = GAP_SHARE * lengths.reduce((sum, length) => sum + length, 0);
    let begin = 0;
    /** @type {Part[]} */
    this.parts = spans.map((span, i) => {
      const part = { ...span, begin, seconds: lengths[i] };
      begin += lengths[i] + gap;
      return part;
    });
    const newest = this.parts[this.parts.length - 1];
    this.seconds = newest ? newest.begin + newest.seconds : 0; // length of the whole
  }

  /** Where a position lies, in seconds from the left. @param {Position} position */
  placeOf(position) {
    const part = this.parts.find(({ epoch }) => epoch === position.epoch);
    if (!part) return position.epoch < (this.parts[0]?.epoch ?? 0) ? 0 : this.seconds;
    const version = Math.min(Math.max(position.version, part.first), part.last);
    const { times, fps } = this,
      begin = times.at({ epoch: part.epoch, version: part.first }, fps);
    return (
      part.begin + Math.min(Math.max((times.at({ epoch: part.epoch, version }, fps) - begin) / 1000, 0), part.seconds)
    );
  }

  /** What was filmed before a place, s: without the gaps. @param {number} place */
  filmedBefore(place) {
    return this.parts.reduce((sum, { begin, seconds }) => sum + Math.min(Math.max(place - begin, 0), seconds), 0);
  }

  /** The place before which so much was filmed. @param {number} seconds */
  placeAfter(seconds) {
    let left = Math.max(seconds, 0);
    for (const part of this.parts) {
      if (left <= part.seconds) return part.begin + left;
      left -= part.seconds;
    }
    return this.seconds;
  }

  /**
   * What was filmed so much later, or the next frame where that is farther.
   * @param {Position} position
   * @param {number} seconds - below 0: earlier
   */
  after(position, seconds) {
    const to = this.positionAt(this.placeAfter(this.filmedBefore(this.placeOf(position)) + seconds));
    if (to?.epoch !== position.epoch || to.version !== position.version) return to;
    return this.positionAt(this.placeOf({ ...position, version: position.version + Math.sign(seconds) }));
  }

  /**
   * How much later the newest was filmed than what lies at a place, s.
   * @param {number} place
   * @param {boolean} isOneClock - or epochs begin their times again: then without what lies between them
   */
  behind(place, isOneClock) {
    const position = this.positionAt(place),
      newest = this.parts[this.parts.length - 1];
    if (!position || !isOneClock) return this.filmedBefore(this.seconds) - this.filmedBefore(place);
    const end = this.times.at({ epoch: newest.epoch, version: newest.last }, this.fps);
    return Math.max(0, end - this.times.at(position, this.fps)) / 1000;
  }

  /** What lies at a place. @param {number} place - seconds from the left @returns {Position | null} */
  positionAt(place) {
    const part = this.parts.filter(({ begin }) => begin <= place).pop() ?? this.parts[0];
    if (!part) return null;
    const next = this.parts[this.parts.indexOf(part) + 1];
    const middle = next && (part.begin + part.seconds + next.begin) / 2; // of the gap behind it
    if (next && place > middle) return { epoch: next.epoch, version: next.first };
    const begin = this.times.at({ epoch: part.epoch, version: part.first }, this.fps);
    return { epoch: part.epoch, version: this.times.versionAt(part, begin + 1000 * (place - part.begin), this.fps) };
  }
}
