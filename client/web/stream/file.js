/** A `.slod` file at an address: its bytes, by range where the server can; what it holds, and parts of it as files. */

import { checkHead, FILE_HEAD, FOOTER, readFooter, readIndex, walkRecords } from "../decode/container.js";
import { KEY, must } from "../decode/packet.js";

const MAX_READ = 1 << 30; // bytes at once

export class FileReader {
  /** @param {string} url @param {string | null} token - where the server asks for one */
  constructor(url, token) {
    this.url = url;
    /** @type {Record<string, string>} */
    this.headers = token ? { Authorization: `Bearer ${token}` } : {};
    /** @type {Uint8Array | null} */
    this.whole = null;
    this.size = 0;
    this.isCut = false; // it ends amid a packet
  }

  /** @param {string} range @returns {Promise<Response>} */
  async #fetch(range) {
    const { origin } = new URL(this.url);
    const answer = await fetch(this.url, { headers: { ...this.headers, Range: `bytes=${range}` } }).catch(() => {
      throw new Error(
        `${origin} does not answer${origin === globalThis.location?.origin ? "" : ", or does not let pages of other sites read its files (CORS)"}`,
      );
    });
    if (!answer.ok) {
      const told = await answer.json().catch(() => null); // what is wrong, where the server says it (RFC 9457)
      const why =
        told?.detail && told.detail !== answer.statusText ? told.detail : `${answer.status} ${answer.statusText}`;
      throw Object.assign(new Error(`the recording cannot be read: ${why}`), { isRefused: answer.status === 401 });
    }
    return answer;
  }

  /** The last `n` bytes; learns the size. @param {number} n */
  async tail(n) {
    const answer = await this.#fetch(`-${n}`);
    const bytes = new Uint8Array(await answer.arrayBuffer());
    if (answer.status === 206) {
      const total = /\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "");
      if (!total)
        throw new Error(
          "the file's server hides the header Content-Range from pages of other sites (CORS): it must expose it",
        );
      this.size = Number(total[1]);
    } else this.#keep(bytes);
    return bytes.subarray(Math.max(0, bytes.length - n));
  }

  /** @param {Uint8Array} bytes */
  #keep(bytes) {
    this.whole = bytes;
    this.size = bytes.length;
  }

  /**
   * A range, each time as much of it as has come.
   * @param {number} start
   * @param {number} end
   * @returns {AsyncGenerator<Uint8Array, void>}
   */
  async *arriving(start, end) {
    if (!this.whole) {
      const answer = await this.#fetch(`${start}-${end - 1}`);
      if (answer.status !== 206 || !answer.body) this.#keep(new Uint8Array(await answer.arrayBuffer()));
      else {
        must(
          end - start <= MAX_READ,
          "limit_exceeded",
          "the recording has no index and is too long to be read without",
        );
        const bytes = new Uint8Array(end - start),
          reader = answer.body.getReader();
        for (let at = 0, more; !(more = await reader.read()).done;) {
          bytes.set(more.value, at);
          yield bytes.subarray(0, (at += more.value.length));
        }
        return;
      }
    }
    yield /** @type {Uint8Array} */ (this.whole).subarray(start, end);
  }

  /** @param {number} start @param {number} end @returns {Promise<Uint8Array>} */
  async read(start, end) {
    /** @type {Uint8Array} */
    let bytes = new Uint8Array(0);
    for await (bytes of this.arriving(start, end));
    must(bytes.length === end - start, "truncated", "the recording ends too early");
    return bytes;
  }

  /** What the file holds. @returns {Promise<import("../decode/container.js").Entry[]>} */
  async entries() {
    const tail = await this.tail(FOOTER),
      { size } = this,
      footer = readFooter(tail, size);
    const [head, content] = await Promise.all([
      this.read(0, Math.min(FILE_HEAD, size)),
      footer && this.read(footer.start, size - FOOTER),
    ]);
    checkHead(head);
    const indexed = footer && content && readIndex(content, footer.checksum, footer.start);
    if (indexed) return indexed;
    const walked = walkRecords(await this.read(0, size)),
      last = walked[walked.length - 1];
    this.isCut = last !== undefined && last.offset + last.size < size;
    return walked;
  }
}

const LENGTH = 4; // bytes before each packet

/**
 * A `.slod` file from the last keyframe at or before version `first` up to `last`. It has no index; every reader walks through such a file.
 * @param {string} url @param {string | null} token @param {number} first @param {number} last
 * @returns {Promise<Blob>}
 */
export async function cut(url, token, first, last) {
  const reader = new FileReader(url, token),
    entries = await reader.entries();
  const begin = entries.reduce(
    (last, { kind, keyframe }) => (kind === KEY && keyframe <= first ? Math.max(last, keyframe) : last),
    -1,
  );
  must(begin >= 0, "bad_file", "The first mark has left the window.");
  const wanted = entries.filter(({ keyframe, toVersion }) => keyframe >= begin && toVersion <= last);
  const parts = [await reader.read(0, FILE_HEAD)];
  for (let i = 0, j; i < wanted.length; i = j) {
    // runs of records that lie side by side
    for (j = i + 1; j < wanted.length && wanted[j].offset === wanted[j - 1].offset + wanted[j - 1].size + LENGTH;) j++;
    parts.push(await reader.read(wanted[i].offset - LENGTH, wanted[j - 1].offset + wanted[j - 1].size));
  }
  return new Blob(/** @type {BlobPart[]} */ (parts));
}
