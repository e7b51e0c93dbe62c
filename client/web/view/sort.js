/** Back-to-front order of splats by view depth: two counting passes over 22 bits of the depth. */

const BITS = 11,
  BUCKETS = 1 << BITS;
export const NEAR = 0.01; // splats nearer than this are not drawn, as in the other renderers

/** Its memory grows with the scene. */
export class DepthSort {
  constructor() {
    this.depth = new Float32Array(0);
    this.key = new Uint32Array(0);
    this.first = new Uint32Array(0);
    this.kept = new Uint32Array(0);
    this.out = new Uint32Array(0);
    this.low = new Uint32Array(BUCKETS);
    this.high = new Uint32Array(BUCKETS);
  }

  /**
   * @param {Float32Array} splats - `stride` numbers a splat, the mean first
   * @param {number} stride
   * @param {Uint32Array} active - splat numbers to draw
   * @param {number} count - how many of `active` count
   * @param {ArrayLike<number>} forward - 3 numbers, the direction of depth, unit length
   * @param {ArrayLike<number>} eye - 3 numbers, where depth begins
   * @param {number} near - distance from there within which nothing is drawn
   * @returns {Uint32Array} splat numbers, far ones first; valid until the next call
   */
  order(splats, stride, active, count, forward, eye, near) {
    if (this.key.length < count) {
      const room = Math.ceil(count * 1.25);
      this.depth = new Float32Array(room);
      this.key = new Uint32Array(this.depth.buffer);
      this.first = new Uint32Array(room);
      this.kept = new Uint32Array(room);
      this.out = new Uint32Array(room);
    }
    const { depth, key, first, kept, out, low, high } = this;
    const { 0: a, 1: b, 2: c } = forward,
      { 0: u, 1: v, 2: w } = eye;
    let shown = 0;
    for (let i = 0; i < count; i++) {
      const o = active[i] * stride;
      const x = splats[o] - u,
        y = splats[o + 1] - v,
        t = splats[o + 2] - w,
        z = a * x + b * y + c * t;
      if (z >= NEAR && x * x + y * y + t * t >= near * near) {
        depth[shown] = z; // bits of positive floats are ordered like the floats
        kept[shown++] = active[i];
      }
    }
    let least = 0xffffffff,
      most = 0;
    for (let i = 0; i < shown; i++) {
      if (key[i] < least) least = key[i];
      if (key[i] > most) most = key[i];
    }
    const shift = Math.max(0, 32 - Math.clz32(most - least) - 2 * BITS);
    low.fill(0);
    high.fill(0);
    for (let i = 0; i < shown; i++) {
      const k = (most - key[i]) >>> shift;
      key[i] = k;
      low[k & (BUCKETS - 1)]++;
      high[k >>> BITS]++;
    }
    for (let i = 0, l = 0, h = 0; i < BUCKETS; i++) {
      const nl = low[i],
        nh = high[i];
      low[i] = l;
      high[i] = h;
      l += nl;
      h += nh;
    }
    for (let i = 0; i < shown; i++) first[low[key[i] & (BUCKETS - 1)]++] = i;
    for (let i = 0; i < shown; i++) {
      const j = first[i];
      out[high[key[j] >>> BITS]++] = kept[j];
    }
    return out.subarray(0, shown);
  }
}
