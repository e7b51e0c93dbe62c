// How fast the page's decoder is: `node codec_speed.mjs FILE.slod [ROUNDS]` decodes the first keyframe's packets again and again.
import { readFileSync } from "node:fs";
import { walkRecords } from "../../client/web/container.js";
import { SceneDecoder } from "../../client/web/decoder.js";
import { Chunk, KEY, parsePacket, Reader } from "../../client/web/packet.js";
import { decodeColumns, RansDecoder, readScales } from "../../client/web/rans.js";

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

// The keyframe's numbers alone: many symbols in one chunk, nothing around them.
const { chunks } = parsePacket(clip[0]);
let fastest = 0;
for (const [place, chunk] of chunks) {
  if ((place & 15) !== Chunk.BASE || chunk[0] === 0) continue;
  const geometry = chunks.get((place & ~15) | Chunk.GEOMETRY);
  const rows = new DataView(geometry.buffer, geometry.byteOffset).getUint32(1, true);
  for (let round = 0; round < Number(rounds); round++) {
    const begin = cpuMilliseconds();
    const { coder, scales } = columnsOf(chunk);
    decodeColumns(coder, rows, scales);
    fastest = Math.max(fastest, (rows * scales.channels) / (cpuMilliseconds() - begin) / 1e3);
  }
}
console.log(`JavaScript, keyframe: ${bestKey.toFixed(1)} ms, entropy decoder alone ${fastest.toFixed(1)} Msymbol/s`);

/** A BASE chunk up to its words. @type {(chunk: Uint8Array) => { coder: RansDecoder, scales: import("../../client/web/rans.js").Scales }} */
function columnsOf(chunk) {
  const channels = channelsOf();
  const reader = new Reader(chunk, "corrupt_chunk");
  const coding = reader.u8();
  const packed = reader.take(Math.ceil(channels / 4));
  for (let c = 0; c < channels; c++) if (((packed[c >> 2] >> (2 * (c & 3))) & 3) === 1) reader.i32();
  const scales = readScales(reader, channels);
  return { scales, coder: new RansDecoder(reader.rest(), coding) };
}

/** Columns of BASE, from HEADER: features, offsets, scalings, extra level, position. @returns {number} */
function channelsOf() {
  const header = chunks.get(Chunk.HEADER);
  return header[2] + 3 * header[1] + 10;
}

/** Time that this process computed, which a busy machine does not lengthen. @returns {number} */
function cpuMilliseconds() {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1000;
}
