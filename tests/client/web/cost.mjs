// Costs of a stream's last packet to the page's decoder: `node --no-opt --no-sparkplug --max-old-space-size=64 cost.mjs
// FILE.slps` prints its refusal code or "accepted", how many blocks of the page's code were run, and by how many MiB the
// process grew at most. Optimised code would leave blocks uncounted.
import { Session } from "node:inspector";
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
const taken = mostMemory(), session = new Session();
session.connect();
asked("Profiler.enable");
asked("Profiler.startPreciseCoverage", { callCount: true, detailed: true });
let code = "accepted";
try {
  decoder.push(last);
} catch (error) {
  if (!(error instanceof BitstreamError)) throw error;
  code = error.code;
}
const own = asked("Profiler.takePreciseCoverage").result.filter(({ url }) => url.startsWith("file:"));
const blocks = own.flatMap(({ functions }) => functions.flatMap(({ ranges }) => ranges.map(({ count }) => count)));
console.log(JSON.stringify([code, blocks.reduce((sum, count) => sum + count, 0), mostMemory() - taken]));

/** What the inspector answers, which it does before `post` returns. */
function asked(method, parameters) {
  let answer;
  session.post(method, parameters, (error, result) => {
    if (error) throw new Error(error.message);
    answer = result;
  });
  return answer;
}

/** MiB that the process has had at most. */
function mostMemory() {
  return Number(/VmHWM:\s+(\d+) kB/.exec(readFileSync("/proc/self/status", "utf8"))[1]) / 1024;
}
