/** The server's clock as seen from here, measured as NTP does (RFC 5905): a question, its answer, half of the way each. */

const DRIFT = 50e-6; // how much faster one quartz may run than another
const KEPT = 32; // measurements

export class ServerClock {
  constructor() {
    /** @type {{ at: number, ahead: number, error: number }[]} */
    this.measured = [];
  }

  /**
   * @param {number} sentMs - local
   * @param {number} receivedMs - local
   * @param {number} serverMs - Unix time between them
   */
  add(sentMs, receivedMs, serverMs) {
    const error = (receivedMs - sentMs) / 2;
    if (!(error >= 0)) return;
    this.measured.push({ at: receivedMs, ahead: serverMs - (sentMs + error), error });
    if (this.measured.length > KEPT) this.measured.shift();
  }

  get count() {
    return this.measured.length;
  }

  /** The measurement that is best now: a short way, not long ago. @param {number} localMs */
  #best(localMs) {
    const errors = this.measured.map(({ at, error }) => error + DRIFT * Math.abs(localMs - at));
    const least = Math.min(...errors);
    return { ahead: this.measured[errors.indexOf(least)]?.ahead ?? NaN, error: least };
  }

  /** Unix time of the server, ms; NaN before the first measurement. @param {number} localMs */
  at(localMs) {
    return localMs + this.#best(localMs).ahead;
  }

  /** How far `at` may be off, ms. @param {number} localMs */
  errorAt(localMs) {
    return this.#best(localMs).error;
  }
}
