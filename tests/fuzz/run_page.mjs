// `node --max-old-space-size=256 tests/fuzz/run_page.mjs TARGET SECONDS SEED`: mutants for the page's modules, for
// so many seconds of processor time.
// An input that takes more than a second of processor time, or that lets out another exception than a refusal, fails
// and is written to tests/fuzz/found. Targets: packet, container, session.
import assert from "node:assert/strict";
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { crc32 } from "../../client/web/decode/checksum.js";
import { checkHead, FILE_HEAD, FOOTER, levelOf, moments, plan, readFooter, readIndex, walkRecords } from "../../client/web/decode/container.js";
import { SceneDecoder } from "../../client/web/decode/decoder.js";
import { HEADER } from "../../client/web/decode/packet.js";
import { BitstreamError } from "../../client/web/decode/scene.js";
import { Session } from "../../client/web/stream/session.js";

const [name, seconds, seed] = [process.argv[2], Number(process.argv[3]), Number(process.argv[4])];
const VECTORS = new URL("../vectors/", import.meta.url);
const MAX_MICROSECONDS = 1e6; // of processor time, an input
const MAX_MEBIBYTES = 1024; // of the whole process, arrays outside of its heap included
const MAX_ROWS = 1000; // of a state that mutants are given to
const text = new TextEncoder(), plain = new TextDecoder();

/** A number from 0 to below n; mulberry32. */
function generator(state) {
  return (n) => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return Math.floor((((t ^ (t >>> 14)) >>> 0) / 4294967296) * n);
  };
}

/** A damaged copy, like those of corpus.py: flipped bits, odd numbers, cuts, insertions. */
function damaged(bytes, random) {
  let data = bytes.slice();
  for (let left = 1 + random(4); left; left--) {
    const at = random((random(4) ? data.length : Math.min(data.length, 64)) + 1), kind = random(5);
    if (kind < 2 && at < data.length) data[at] ^= 1 << random(8);
    else if (kind === 2 && at < data.length) data[at] = [0, 1, 4, 127, 128, 255][random(6)];
    else if (kind === 3) data = spliced(data, at, 1 + random(8), []);
    else data = spliced(data, at, 0, Array.from({ length: 1 + random(8) }, () => random(256)));
  }
  return data;
}

function spliced(data, at, gone, more) {
  const end = Math.min(data.length, at + gone), result = new Uint8Array(data.length - (end - at) + more.length);
  result.set(data.subarray(0, at));
  result.set(more, at);
  result.set(data.subarray(end), at + more.length);
  return result;
}

/** In place: lengths that fit and the checksums that the packet's own directory asks for, so that mutants reach the inside. */
function repair(data) {
  if (data.length < HEADER + 8) return data;
  const view = new DataView(data.buffer, data.byteOffset, data.length), count = view.getUint16(30, true), start = HEADER + 8 * count;
  if (start > data.length || count === 0) return data;
  let at = start;
  for (let i = HEADER; i < start; i += 8) {
    const word = view.getUint32(i, true), last = i === start - 8 && at <= data.length && data.length % 4;
    const length = last ? data.length - at : word & 0xffffff;
    view.setUint32(i, ((word & 0xff000000) | length) >>> 0, true);
    view.setUint32(i + 4, crc32(data.subarray(at, at + length)), true);
    at += length;
  }
  view.setUint32(HEADER - 4, crc32(data.subarray(HEADER, start), crc32(data.subarray(0, HEADER - 4))), true);
  return data;
}

function stream(file) {
  const bytes = new Uint8Array(readFileSync(new URL(file, VECTORS))), packets = [];
  for (let at = 0; at < bytes.length; ) {
    const size = new DataView(bytes.buffer, bytes.byteOffset).getUint32(at, true);
    packets.push(bytes.slice(at + 4, at + 4 + size));
    at += 4 + size;
  }
  return packets;
}

/** Runs what may be refused. */
function refusable(run) {
  try {
    run();
  } catch (error) {
    if (!(error instanceof BitstreamError)) throw error;
  }
}

/** The last packet of each conformance stream, for the state that it belongs to. */
function packetTarget() {
  const subjects = [];
  for (const file of readdirSync(VECTORS).filter((file) => file.endsWith(".slps")).sort()) {
    const packets = stream(file), decoder = new SceneDecoder();
    for (const packet of packets.slice(0, -1)) decoder.push(packet);
    const rows = decoder.scene?.levels.reduce((sum, { count }) => sum + count, 0) ?? 0;
    if (rows < MAX_ROWS && packets.at(-1).length < 65536) subjects.push({ scene: decoder.scene, data: packets.at(-1) });
  }
  return { subjects, mend: repair, run(data, { scene }) {
    const decoder = new SceneDecoder();
    decoder.scene = scene;
    try {
      decoder.push(data);
    } catch (error) {
      if (!(error instanceof BitstreamError)) throw error;
      assert.equal(decoder.scene, scene);
    }
  } };
}

/** Files: the index or the records, the way to the last version, the packets on it, and a keyframe as its bytes come. */
function containerTarget() {
  const subjects = [{ data: new Uint8Array(readFileSync(new URL("growth.slod", VECTORS))) }];
  return { subjects, mend: mendFile, run(data) {
    refusable(() => checkHead(data.subarray(0, FILE_HEAD)));
    const footer = readFooter(data.subarray(-FOOTER), data.length);
    const entries = (footer && readIndex(data.subarray(footer.start, -FOOTER), footer.checksum, footer.start)) ?? walkRecords(data);
    const decoder = new SceneDecoder();
    const packetOf = ({ offset, size }) => data.subarray(offset, offset + size);
    refusable(() => {
      const last = moments(entries).at(-1)?.version ?? 0;
      for (const i of plan(entries, last, null)) refusable(() => decoder.push(packetOf(entries[i])));
    });
    const first = entries.length ? packetOf(entries[0]) : data.subarray(12);
    refusable(() => {
      for (let level = 0, part; level < 4 && (part = levelOf(first, level)); level++) if (part.length) decoder.push(part);
    });
  } };
}

/** The packets of a file with the right checksums, and its index. */
function mendFile(data) {
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  let at = 8;
  for (; at + 4 <= data.length; ) {
    const size = view.getUint32(at, true);
    if (size > data.length - at - 4) break;
    repair(data.subarray(at + 4, at + 4 + size));
    at += 4 + size;
  }
  if (data.length - at >= 16) view.setUint32(data.length - 8, crc32(data.subarray(at, data.length - 16)), true);
  return data;
}

/** What a server may say: any text is taken, or ends the session. */
function sessionTarget() {
  const place = { epoch: 1, version: 9 }, welcome = { type: "welcome", version: 1, stream: "main", state: "live", epoch: 1, levels: 2, fps: 30, ack_every: 2,
    window: { oldest: place, newest: place }, server_time_ns: 5e9, progress: { fraction: 0.5, loss: null, text: "first frame" } };
  const events = [{ event: "position", mode: "live", ...place, clamped: true }, { event: "epoch", epoch: 2 }, { event: "levels", levels: 1, reason: "congestion" },
    { event: "caught_up" }, { event: "window", oldest: place, newest: place }, { event: "skipped", from: 1, to: 9, reason: "congestion" },
    { event: "state", state: "degraded", detail: "camera lost" }, { event: "progress", fraction: 0.1, loss: 2, text: "a" }];
  const lines = [welcome, ...events.map((fields) => ({ type: "event", ...fields }))].map((message) => JSON.stringify(message));
  const subjects = lines.map((line) => ({ data: text.encode(line) }));
  return { subjects, mend: (data) => data, run(data) {
    const session = new Session(0);
    session.opened(0);
    session.control(lines[0], 1, 2);
    session.control(plain.decode(data), 3, 4);
    session.arrived(100, 5);
    session.applied(7, 1, 6);
    session.tick(5000);
    session.closed(1006, "", 6000, 0.5);
    assert.ok([null, "failed", "version"].includes(session.verdict));
  } };
}

const { subjects, mend, run } = { packet: packetTarget, container: containerTarget, session: sessionTarget }[name]();
const random = generator(seed), begin = process.cpuUsage(), end = 1e6 * seconds;
let count = 0;
for (let used = 0; used < end; count++) {
  const subject = subjects[random(subjects.length)], mutant = damaged(subject.data, random);
  const data = count % 16 ? mend(mutant) : mutant;
  try {
    run(data, subject);
    const { user, system } = process.cpuUsage(begin), own = user + system - used;
    used += own;
    assert.ok(own < MAX_MICROSECONDS, "an input takes more than a second");
  } catch (error) {
    writeFileSync(new URL(`found/page-${name}-${seed}-${count}.bin`, import.meta.url), data);
    throw error;
  }
}
// not resourceUsage(): its peak counts the process that started this one
const mebibytes = Number(/VmHWM:\s+(\d+) kB/.exec(readFileSync("/proc/self/status", "utf8"))[1]) / 1024;
assert.ok(mebibytes < MAX_MEBIBYTES, `the process took ${mebibytes} MiB`);
console.log(`page ${name}, seed ${seed}: ${count} executions in ${seconds} s of processor time, no finding`);
