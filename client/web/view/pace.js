/** How long drawing takes: of the newest picture, and the rate that it sustains. */

const VSYNC_MS = 25,
  ASLEEP_MS = 3000; // between two frames: more means that drawing was waited for; that nobody looked

export class Pace {
  constructor() {
    this.frameMs = 0; // that the newest picture took
    this.fps = 0;
    this.frames = 0;
    this.timed = { frames: 0, ms: 0 }; // drawn since `sustained` was asked for, and the time that took
    this.lastFrame = -Infinity;
    this.lastDraw = 0;
    this.drew = this.drewAll = false; // since the last frame: while things move; everything there is
  }

  /** How long it is until the next frame says nothing, as nobody looks. */
  skip() {
    this.lastFrame = -Infinity;
  }

  /**
   * Time that drawing took: that until the next frame, which begins, and that of frames which came late.
   * @param {number} now
   * @returns {{ ms: number, drew: boolean, all: boolean }} since the last frame; whether something was drawn for somebody who looked, and everything
   */
  tick(now) {
    const { drew, drewAll: all } = this,
      ms = now - this.lastFrame,
      awake = ms < ASLEEP_MS;
    this.lastFrame = now;
    this.drew = this.drewAll = false;
    if (drew && awake) this.frameMs = ms;
    if (awake && (drew || ms > VSYNC_MS)) {
      this.timed.frames += Number(drew);
      this.timed.ms += ms;
    }
    return { ms, drew: (drew || all) && awake, all };
  }

  /**
   * A picture was drawn in the frame that began then.
   * @param {number} now
   * @param {boolean} moves - whether things move
   * @param {boolean} all - whether it is everything there is
   */
  draw(now, moves, all) {
    this.drew = moves;
    this.drewAll = all;
    const elapsed = now - this.lastDraw;
    this.lastDraw = now;
    if (elapsed < 1000) this.fps += (1000 / Math.max(elapsed, 1) - this.fps) * (this.frames++ < 3 ? 1 : 0.1);
  }

  /** Frames a second that drawing sustained since the last answer; null: too little to tell. */
  sustained() {
    const { frames, ms } = this.timed;
    if (frames < 2 || ms < 200) return null;
    this.timed = { frames: 0, ms: 0 };
    return (1000 * frames) / ms;
  }
}
