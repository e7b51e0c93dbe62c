// How fast the page's decoder is: `node codec_speed.mjs FILE.slod [ROUNDS]` decodes the first keyframe's packets again and again.
import { readFileSync } from "node:fs";
import { walkRecords } from "../../client/web/decode/container.js";
import { SceneDecoder } from "../../client/web/decode/decoder.js";
import { decodeGeometry } from "../../client/web/decode/geometry.js";
import { Chunk, KEY, parsePacket } from "../../client/web/decode/packet.js";
import { decodeBase } from "../../client/web/decode/rows.js";

const ROOM = { rows: 1 << 20, bytes: 1 << 24 };
const [file, rounds = "5"] = process.argv.slice(2);
const bytes = new Uint8Array(readFileSync(file));
const packets = [...walkRecords(bytes)].map(({ offset, size }) => bytes.slice(offset, offset + size));
const end = packets.findIndex((packet, i) => i > 0 && parsePacket(packet).kind === KEY && parsePacket(packet).keyframe > 0);
const clip = end < 0 ? packets : packets.slice(0, end);

let best = Infinity, bestKey = Infinity, symbols = 0;
for (let round = 0; round < Number(rounds); round++) {
  const decoder = new SceneDecoder();
  let begin = cpuMilliseconds();
  decoder.push(clip[0]);
  bestKey = Math.min(bestKey, cpuMilliseconds() - begin);
  symbols = 0;
  begin = cpuMilliseconds();
  for (const packet of clip.slice(1)) for (const { rows } of decoder.push(packet).levels) symbols += 27 * (rows?.length ?? 0);
  best = Math.min(best, cpuMilliseconds() - begin);
}
const frames = Math.max(clip.length - 1, 1);
console.log(`JavaScript, whole packets: ${(best / frames).toFixed(2)} ms a frame, ${(symbols / best / 1e3).toFixed(1)} Msymbol/s`);

// The keyframe's rows alone: many symbols in one chunk.
const { chunks } = parsePacket(clip[0]);
const [, slots, features] = chunks.get(Chunk.HEADER);
let fastest = 0;
for (const [place, chunk] of chunks) {
  if ((place & 15) !== Chunk.BASE) continue;
  const voxel = decodeGeometry(chunks.get((place & ~15) | Chunk.GEOMETRY), ROOM);
  for (let round = 0; round < Number(rounds); round++) {
    const begin = cpuMilliseconds();
    decodeBase(chunk, voxel, features, slots, ROOM);
    const symbols = (voxel.length / 3) * (features + 3 * slots + 10);
    fastest = Math.max(fastest, symbols / (cpuMilliseconds() - begin) / 1e3);
  }
}
console.log(`JavaScript, keyframe: ${bestKey.toFixed(1)} ms, its rows ${fastest.toFixed(1)} Msymbol/s`);

/** Time that this process computed, which a busy machine does not lengthen. @returns {number} */
function cpuMilliseconds() {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1000;
}
