// What the last packet of a stream costs the page's decoder: `node --max-old-space-size=64 cost.mjs FILE.slps` prints
// its refusal code or "accepted", the seconds of processor time and by how many MiB the process grew at most.
import { readFileSync, writeFileSync } from "node:fs";
import { SceneDecoder } from "../../../client/web/decode/decoder.js";
import { BitstreamError } from "../../../client/web/decode/scene.js";

const bytes = new Uint8Array(readFileSync(process.argv[2])), packets = [];
for (let at = 0; at < bytes.length; ) {
  const size = new DataView(bytes.buffer, bytes.byteOffset).getUint32(at, true);
  packets.push(bytes.slice(at + 4, at + 4 + size));
  at += 4 + size;
}
const decoder = new SceneDecoder(), last = packets.pop();
for (const packet of packets) decoder.push(packet);
writeFileSync("/proc/self/clear_refs", "5"); // Linux: forget the most memory that the process has had so far
const taken = mostMemory(), begin = process.cpuUsage();
let code = "accepted";
try {
  decoder.push(last);
} catch (error) {
  if (!(error instanceof BitstreamError)) throw error;
  code = error.code;
}
const { user, system } = process.cpuUsage(begin);
console.log(JSON.stringify([code, (user + system) / 1e6, mostMemory() - taken]));

/** MiB that the process has had at most. */
function mostMemory() {
  return Number(/VmHWM:\s+(\d+) kB/.exec(readFileSync("/proc/self/status", "utf8"))[1]) / 1024;
}
