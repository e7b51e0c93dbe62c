/** A part of a recording as a file of its own. */

import { KEY, must } from "../decode/packet.js";
import { FileReader } from "./file.js";

const FILE_HEAD = 8, LENGTH = 4; // bytes before the first record, and before each packet

/**
 * A `.slod` file from the last keyframe at or before version `first` up to `last`. It has no index; every reader walks through such a file.
 * @param {string} url @param {string | null} token @param {number} first @param {number} last
 * @returns {Promise<Blob>}
 */
export async function cut(url, token, first, last) {
  const reader = new FileReader(url, token), entries = await reader.entries();
  const keys = entries.filter(({ kind, keyframe }) => kind === KEY && keyframe <= first);
  must(keys.length, "bad_file", "The first mark has left the window.");
  const begin = Math.max(...keys.map(({ keyframe }) => keyframe));
  const wanted = entries.filter(({ keyframe, toVersion }) => keyframe >= begin && toVersion <= last);
  const parts = [await reader.read(0, FILE_HEAD)];
  for (let i = 0, j; i < wanted.length; i = j) { // runs of records that lie side by side
    for (j = i + 1; j < wanted.length && wanted[j].offset === wanted[j - 1].offset + wanted[j - 1].size + LENGTH; ) j++;
    parts.push(await reader.read(wanted[i].offset - LENGTH, wanted[j - 1].offset + wanted[j - 1].size));
  }
  return new Blob(/** @type {BlobPart[]} */ (parts));
}
