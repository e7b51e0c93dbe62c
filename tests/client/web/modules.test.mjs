// The page's modules that need no page.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { deflateRawSync } from "node:zlib";
import * as camera from "../../../client/web/view/camera.js";
import { crc32 } from "../../../client/web/decode/checksum.js";
import { FOOTER, moments, plan, readFooter, readIndex, walkRecords } from "../../../client/web/decode/container.js";
import { inflateColumns } from "../../../client/web/decode/deflate.js";
import { Reader } from "../../../client/web/decode/packet.js";
import { follow } from "../../../client/web/lib/follow.js";
import { rigUp, upright, viewOf } from "../../../client/web/lib/rig.js";
import { cross, row } from "../../../client/web/lib/vectors.js";
import { braked, held, outside, seenSpace, spread } from "../../../client/web/view/limits.js";
import { Quality } from "../../../client/web/view/quality.js";
import { ServerClock } from "../../../client/web/stream/clock.js";
import { heard } from "../../../client/web/stream/heard.js";
import { phaseOf } from "../../../client/web/stream/phase.js";
import { pack } from "../../../client/web/stream/push.js";
import { Session } from "../../../client/web/stream/session.js";
import { isSlow, part } from "../../../client/web/view/device.js";
import { DepthSort } from "../../../client/web/view/sort.js";
import { facing, microphoneAt, reachOf } from "../../../client/web/view/placed-sound.js";
import { clock, duration, words } from "../../../client/web/ui/states.js";
import { foremost } from "../../../client/web/ui/streams.js";
import { turnAt, turns } from "../../../client/web/view/flight.js";
import { Bar, Times } from "../../../client/web/ui/times.js";
import { bin, FREQUENCY, SCALE } from "../../../client/web/decode/tables.js";

const near = (a, b, tolerance = 1e-9) => a.forEach((x, i) => assert.ok(Math.abs(x - b[i]) <= tolerance, `${a} is not ${b}`));
const POSE = { rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], position: [0, 0, -3], distance: 3, focal: 1, stretch: 1, shift: [0, 0] };
const UP = [0, -1, 0];

test("crc32 is that of zlib", () => assert.equal(crc32(new TextEncoder().encode("123456789")), 0xcbf43926));

test("orbiting keeps the target and its distance", () => {
  const pose = camera.orbit(camera.orbit(POSE, UP, 0.7, 0.4), UP, -0.2, -0.9);
  near(camera.target(pose), [0, 0, 0], 1e-9);
  near([Math.hypot(...pose.position)], [3]);
});

test("sound comes from its camera, to ears that face as the page does", () => {
  const turned = { ...POSE, rotation: [0, 0, -1, 0, 1, 0, 1, 0, 0] }; // looks along +x; its right is -z
  const [r, t] = [turned.rotation, [1, 2, 3]];
  const cameras = [{ name: "a", worldToCamera: [...r.slice(0, 3), t[0], ...r.slice(3, 6), t[1], ...r.slice(6), t[2], 0, 0, 0, 1] }];
  near(microphoneAt(cameras, "a"), [-3, -2, 1]); // r x + t is 0 there
  for (const name of ["b", null, undefined, 7]) assert.equal(microphoneAt(cameras, name), null);
  const { ahead, up } = facing(turned.rotation);
  near(ahead, [1, 0, 0]);
  near(up, [0, -1, 0]);
  near(cross(ahead, up), [0, 0, -1]); // what an audio listener takes for its right
  near([reachOf([-3, -2, 1], [0, 2, 1])], [5]);
  assert.ok(reachOf([1, 1, 1], [1, 1, 1]) > 0);
});

test("positive yaw shows what lies to the right, positive pitch what lies above", () => {
  const right = camera.look(POSE, UP, 0.3, 0), high = camera.look(POSE, UP, 0, 0.3);
  assert.ok(right.rotation[6] > 0.2 && high.rotation[7] < -0.2);
});

test("pitch stops before the pole and leaves the picture level", () => {
  let pose = POSE;
  for (let i = 0; i < 100; i++) pose = camera.orbit(pose, UP, 0.05, 0.1);
  const forward = row(pose.rotation, 2), right = row(pose.rotation, 0);
  assert.ok(Math.abs(forward[1]) < 0.9999);
  near([right[1]], [0], 1e-9);
});

test("a pose survives its text", () => {
  const pose = camera.pan(camera.orbit(POSE, UP, 0.7, 0.4), 0.1, -0.2);
  const back = camera.fromText(camera.toText(pose));
  near(back.rotation, pose.rotation, 1e-3);
  near(back.position, pose.position, 1e-3);
  for (const text of [null, "", "1,2,3", "0,0,0,0,0,1,0,0,1,1,1,0,0,1", "0,0,0,0,0,1,0,1,0,1,-1,0,0,1", "a,0,0,0,0,1,0,1,0,1,1,0,0,1"]) {
    assert.equal(camera.fromText(text), null);
  }
});

test("a rig camera's pose has its centre, focal length and principal point", () => {
  const rig = { name: "a", width: 400, height: 200, intrinsics: [330, 0, 210, 0, 300, 90, 0, 0, 1], worldToCamera: [0, 0, 1, 4, 0, 1, 0, 5, -1, 0, 0, 6, 0, 0, 0, 1] };
  const pose = camera.fromCamera(rig, 2);
  near(pose.position, [6, -5, -4]);
  near([pose.focal, pose.stretch, ...pose.shift], [1.5, 1.1, 0.05, -0.05]);
});

test("sorted far to near, nothing behind the camera", () => {
  const count = 5000, splats = new Float32Array(count * 4);
  for (let i = 0; i < count; i++) splats[4 * i + 2] = ((i * 7919) % count) * (i % 3 ? 0.01 : 30) - 1;
  const active = Uint32Array.from({ length: count }, (_, i) => i);
  const order = [...new DepthSort().order(splats, 4, active, count, [0, 0, 1], [0, 0, 0], 0)];
  const wanted = [...active].filter((i) => splats[4 * i + 2] >= 0.01);
  assert.equal(order.length, wanted.length);
  assert.deepEqual([...order].sort((a, b) => a - b), wanted);
  for (let i = 1; i < order.length; i++) {
    const far = splats[4 * order[i - 1] + 2], close = splats[4 * order[i] + 2];
    assert.ok(far >= close * (1 - 2e-6) - 1e-6, `${far} before ${close}`);
  }
});

test("two triangles a splat", () => {
});

test("tables: frequencies fill 4096, bins step where they should", () => {
  for (let b = 0; b < 31; b++) assert.equal(FREQUENCY.slice(17 * b, 17 * b + 17).reduce((a, x) => a + x), 4096);
  assert.deepEqual([0, 3, 4, 663, 664, 789, 790].map(bin), [0, 0, 1, 29, 30, 30, bin(395) + 4]);
  assert.equal(SCALE.length, 192);
});

test("inflates what zlib deflates, at every level and strategy", () => {
  const values = Int32Array.from({ length: 3 * 2000 }, (_, i) => (i % 7 ? (i * i) % 23 : i) - 5);
  const noise = Int32Array.from({ length: 3 * 2000 }, (_, i) => Math.imul(i, 0x9e3779b1));
  for (const numbers of [values, noise]) {
    for (const options of [{ level: 0 }, { level: 1 }, { level: 9 }, { strategy: 4 }, { strategy: 2 }]) {
      const body = deflateRawSync(new Uint8Array(numbers.buffer), options);
      const inflated = (/** @type {Uint8Array} */ bytes) => inflateColumns(new Reader(bytes, "corrupt_chunk"), 2000, 3);
      assert.deepEqual(inflated(body), numbers);
      assert.throws(() => inflated(body.slice(0, -1)), { code: "corrupt_chunk" });
      assert.throws(() => inflated(Uint8Array.of(...body, 0)), { code: "corrupt_chunk" });
    }
  }
});

test("inflating any damaged bytes ends in a refusal or in numbers", () => {
  const body = deflateRawSync(new Uint8Array(Int32Array.from({ length: 300 }, (_, i) => i * i).buffer));
  for (let i = 0; i < 3000; i++) {
    const damaged = Uint8Array.from(body);
    damaged[(i * 31) % body.length] ^= 1 << (i % 8);
    damaged[(i * 17) % body.length] ^= i & 255;
    try {
      assert.equal(inflateColumns(new Reader(damaged, "corrupt_chunk"), 100, 3).length, 300);
    } catch (error) {
      assert.equal(error.code, "corrupt_chunk");
    }
  }
});

const entry = (kind, keyframe, fromVersion, toVersion, size) => ({ offset: 0, kind, keyframe, fromVersion, toVersion, size, mask: 3, timeMs: toVersion * 10 });

test("the way to a version: parts of the keyframe, then the fewest bytes", () => {
  const entries = [entry(0, 0, 0, 0, 50), entry(0, 0, 0, 0, 80), entry(1, 0, 0, 1, 10), entry(1, 0, 1, 2, 10), entry(1, 0, 0, 2, 15),
    entry(1, 0, 2, 3, 10), entry(0, 3, 3, 3, 90), entry(1, 3, 3, 4, 10)];
  assert.deepEqual(plan(entries, 2, null), [0, 1, 4]);
  assert.deepEqual(plan(entries, 1, null), [0, 1, 2]);
  assert.deepEqual(plan(entries, 2, { keyframe: 0, version: 1 }), [3]);
  assert.deepEqual(plan(entries, 1, { keyframe: 0, version: 2 }), [0, 1, 2]);
  assert.deepEqual(plan(entries, 4, { keyframe: 0, version: 2 }), [6, 7]);
  assert.deepEqual(moments(entries).map(({ version }) => version), [0, 1, 2, 3, 4]);
  assert.throws(() => plan(entries.slice(2), 1, null), { code: "bad_file" });
});

/** A `.slod` file of the packets of a stream, with the index given or its own. */
function fileOf(packets, entries) {
  const size = (n) => Uint8Array.from([n, n >> 8, n >> 16, n >> 24]);
  const head = [83, 76, 79, 68, 1, 0, 0, 0], records = packets.flatMap((packet) => [...size(packet.length), ...packet]);
  const index = new DataView(new ArrayBuffer(8 + 40 * entries.length));
  index.setUint32(0, 0xffffffff, true);
  index.setUint32(4, entries.length, true);
  entries.forEach(({ offset, size, kind }, i) => {
    index.setBigUint64(8 + 40 * i, BigInt(offset), true);
    index.setUint32(16 + 40 * i, size, true);
    index.setUint8(40 + 40 * i, kind);
  });
  const footer = new DataView(new ArrayBuffer(16)), bytes = new Uint8Array(index.buffer);
  footer.setBigUint64(0, BigInt(8 + records.length), true);
  footer.setUint32(8, crc32(bytes), true);
  footer.setUint32(12, 0x58494c53, true);
  return Uint8Array.from([...head, ...records, ...bytes, ...new Uint8Array(footer.buffer)]);
}

test("an index is believed only if all of it is sound; otherwise the records are walked", () => {
  const stream = new Uint8Array(readFileSync(new URL("../../vectors/valid-growth-profile1.slps", import.meta.url)));
  const packets = [];
  for (let at = 0; at < stream.length; ) {
    const size = new DataView(stream.buffer, stream.byteOffset).getUint32(at, true);
    packets.push(stream.slice(at + 4, at + 4 + size));
    at += 4 + size;
  }
  let at = 12;
  const entries = packets.map(({ length }, i) => ({ offset: (at += i ? packets[i - 1].length + 4 : 0), size: length, kind: i ? 1 : 0 }));
  const read = (/** @type {Uint8Array} */ file) => {
    const footer = readFooter(file.subarray(-FOOTER), file.length);
    return footer && readIndex(file.subarray(footer.start, -FOOTER), footer.checksum, footer.start);
  };
  const whole = fileOf(packets, entries);
  assert.deepEqual(read(whole).map(({ offset, size, kind }) => ({ offset, size, kind })), entries);
  assert.deepEqual(walkRecords(whole).map(({ offset, size, kind }) => ({ offset, size, kind })), entries);
  for (const wrong of [{ offset: 11 }, { size: 1 << 25 }, { offset: whole.length }, { kind: 2 }]) {
    assert.equal(read(fileOf(packets, [{ ...entries[0], ...wrong }, ...entries.slice(1)])), null);
  }
  const damaged = Uint8Array.from(whole);
  damaged[whole.length - 30] ^= 1;
  assert.equal(read(damaged), null);
  assert.equal(walkRecords(whole.subarray(0, entries[2].offset + 50)).length, 2);
  const broken = Uint8Array.from(whole);
  broken[entries[1].offset + 33] ^= 1; // the header's checksum no longer fits
  assert.equal(walkRecords(broken).length, 1);
});

const welcome = (more = {}) => JSON.stringify({ type: "welcome", version: 1, state: "live", epoch: 1, levels: 3, fps: 30, ack_every: 4,
  window: { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 9 } }, ...more });
const event = (name, more = {}) => JSON.stringify({ type: "event", event: name, ...more });

test("session: hello, welcome, packets, acknowledgement every few packets and at least once a second", () => {
  const session = new Session(0);
  session.wishes = { levels: 2, kilobytes_per_second: null };
  assert.deepEqual(session.opened(0), [{ type: "hello", versions: [1], client: "streamlod-web/1.0", start: "live", levels: 2 }]);
  session.control(welcome());
  assert.equal(session.status.phase, "waiting");
  session.arrived(100, 10);
  assert.deepEqual(session.applied(9, 1, 10), []);
  assert.equal(session.status.phase, "live");
  for (let i = 0; i < 2; i++) assert.deepEqual(session.applied(10 + i, 1, 20), []);
  assert.deepEqual(session.applied(12, 1.234, 20), [{ type: "ack", bytes: 100, epoch: 1, version: 12, decode_ms: 1.23 }]);
  session.applied(13, 1, 30);
  assert.equal(session.tick(500).length, 0);
  assert.equal(session.tick(1000).length, 1);
});

test("session: silence is a stall, the next frame ends it; an idle stream only waits", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome({ state: "starting", window: null, levels: null, fps: null }));
  session.control(event("progress", { fraction: 0.4, loss: null, text: "step 400" }));
  session.tick(60_000);
  assert.deepEqual([session.status.phase, session.status.fraction], ["waiting", 0.4]);
  session.control(event("state", { state: "live", detail: "" }));
  session.arrived(1, 60_000);
  session.applied(1, 1, 60_000);
  session.tick(64_000);
  assert.equal(session.status.phase, "stalled");
  session.arrived(1, 64_001);
  session.applied(2, 1, 64_001);
  assert.equal(session.status.phase, "live");
});

test("session: seek, pause and the live edge are told apart", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome());
  session.applied(9, 1, 0);
  session.control(event("position", { mode: "replay", epoch: 1, version: 3 }));
  assert.equal(session.status.phase, "behind");
  session.control(event("position", { mode: "paused", epoch: 1, version: 3 }));
  assert.equal(session.status.phase, "paused");
  session.control(event("position", { mode: "live", epoch: 1, version: 9 }));
  assert.equal(session.status.phase, "live");
  session.control(event("skipped", { from: 9, to: 14, reason: "congestion" }));
  assert.equal(session.status.skipped, 4);
  session.control(event("something new"));
});

test("session: back-off is short four times, doubles to 15 s, starts anew after a welcome, and returns to where the viewer was", () => {
  const session = new Session(0);
  const waits = Array.from({ length: 10 }, () => session.closed(1006, "", 0, 0.5));
  assert.deepEqual(waits, [500, 500, 500, 500, 1000, 2000, 4000, 8000, 15000, 15000]);
  session.opened(0);
  session.control(welcome());
  session.applied(5, 1, 0);
  session.control(event("position", { mode: "replay", epoch: 1, version: 5 }));
  assert.equal(session.closed(1001, "", 0, 0.5), 500);
  assert.deepEqual(/** @type {any} */ (session.opened(0)[0]).start, { epoch: 1, version: 5 });
});

test("session: what was shown can be sought, before the window is told again", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome());
  session.control(event("window", { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 20 } }));
  session.applied(39, 1, 0);
  assert.deepEqual(session.status.window, { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 39 } });
  session.applied(11, 1, 0);
  assert.equal(session.status.window.newest.version, 39);
});

test("how far behind follows from when frames were filmed, not from how many they are", () => {
  const session = new Session(0), ns = (/** @type {number} */ seconds) => seconds * 1e9;
  session.opened(0);
  const range = (/** @type {number} */ newest, /** @type {number} */ seconds) => ({ oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: newest }, newest_time_ns: ns(seconds) });
  session.control(welcome({ window: range(9, 72), fps: 30 })); // one frame in eight seconds is trained
  session.applied(9, 1, 0, 72_000);
  assert.equal(session.status.lagSeconds, 0);
  session.control(event("window", range(10, 80)));
  assert.equal(session.status.lagSeconds, 8);
  assert.equal(session.status.phase, "live", "the newest one is on its way");
  session.control(event("window", range(11, 88)));
  assert.equal(session.status.phase, "behind");
  assert.equal(session.status.lagSeconds, 16);
  session.applied(12, 1, 0, 96_000);
  assert.equal(session.status.newestMs, 96_000);
  assert.equal(session.status.phase, "live");
  session.control(welcome({ epoch: 2, source: "data", window: { oldest: { epoch: 1, version: 0 }, newest: { epoch: 2, version: 3 }, newest_time_ns: ns(1) } }));
  assert.equal(session.status.lagSeconds, null, "pictures taken earlier begin their times again in each epoch");
  assert.equal(session.status.phase, "behind");
});

test("the bar is as long as was filmed, with gaps between the epochs", () => {
  const times = new Times();
  assert.equal(Math.round(times.at({ epoch: 1, version: 60 }, 30)), 2000, "nothing is known but the pace");
  for (const [version, seconds] of [[0, 100], [10, 180], [20, 190]]) times.note({ epoch: 1, version }, 1000 * seconds);
  times.note({ epoch: 3, version: 0 }, 5_000_000);
  times.note({ epoch: 3, version: 10 }, 5_010_000);
  assert.equal(times.at({ epoch: 1, version: 5 }, 30), 140_000);
  assert.equal(times.at({ epoch: 1, version: 22 }, 30), 199_000, "on at the mean pace");
  const bar = new Bar([{ epoch: 1, first: 0, last: 20 }, { epoch: 3, first: 0, last: 10 }], times, 30), gap = 0.015 * 100;
  assert.equal(bar.seconds, 90 + gap + 10);
  assert.equal(bar.placeOf({ epoch: 1, version: 10 }), 80);
  assert.equal(bar.placeOf({ epoch: 3, version: 5 }), 90 + gap + 5);
  assert.deepEqual(bar.positionAt(80), { epoch: 1, version: 10 });
  assert.deepEqual(bar.positionAt(79.9), { epoch: 1, version: 9 });
  assert.deepEqual(bar.positionAt(90 + gap + 5), { epoch: 3, version: 5 });
  assert.deepEqual(bar.positionAt(1e9), { epoch: 3, version: 10 });
  assert.deepEqual(bar.positionAt(-1), { epoch: 1, version: 0 });
  assert.equal(bar.filmedBefore(90 + gap + 5), 95, "nothing was filmed in the gap");
  assert.equal(bar.filmedBefore(90 + gap / 2), 90);
  assert.deepEqual([-1, 80, 90, 95, 1e9].map((seconds) => bar.placeAfter(seconds)), [0, 80, 90, 90 + gap + 5, bar.seconds]);
  assert.equal(bar.behind(80, true), 5010 - 180, "by one clock, with the time between the epochs");
  assert.equal(bar.behind(80, false), 20);
  assert.equal(bar.behind(bar.seconds, true), 0);
  assert.deepEqual([bar.positionAt(90 + 0.4 * gap), bar.positionAt(90 + 0.6 * gap)], [{ epoch: 1, version: 20 }, { epoch: 3, version: 0 }]);
  assert.deepEqual(bar.after({ epoch: 1, version: 10 }, -5), { epoch: 1, version: 9 });
  assert.deepEqual(bar.after({ epoch: 1, version: 0 }, 5), { epoch: 1, version: 1 }, "frames lie 8 s apart: the next one");
  assert.deepEqual(bar.after({ epoch: 3, version: 10 }, 5), { epoch: 3, version: 10 });
  assert.deepEqual(bar.after({ epoch: 1, version: 0 }, -5), { epoch: 1, version: 0 });
  assert.equal(new Bar([], times, 30).positionAt(3), null);
  for (let version = 0; version < 10_000; version++) times.note({ epoch: 4, version }, 33 * version);
  assert.ok((times.known.get(4)?.length ?? 0) <= 4096);
  assert.equal(times.at({ epoch: 4, version: 5001 }, 30), 33 * 5001);
});

test("phase: each follows from its facts, and nothing contradicts it", () => {
  const all = (function* () {
    for (const link of ["opening", "open", "broken"]) for (const verdict of [null, "deleted", "denied"])
    for (const stream of ["", "idle", "starting", "live", "degraded", "ended", "failed"]) for (const source of ["cameras", "data", "recording"])
    for (const mode of ["live", "replay", "paused"]) for (const hasFrame of [false, true]) for (const hasWindow of [false, true])
    for (const isOver of [false, true]) for (const isBehind of [false, true]) for (const isQuiet of [false, true]) {
      yield { link, verdict, stream, source, mode, hasFrame, hasWindow, isOver, isBehind, isQuiet };
    }
  })();
  const seen = new Set();
  for (const facts of all) {
    const phase = phaseOf(facts);
    seen.add(phase);
    /** @type {Record<string, boolean>} what must hold where a phase is told */
    const needs = {
      live: facts.link === "open" && facts.mode === "live" && facts.hasFrame && !facts.isQuiet && !facts.isBehind
        && facts.source !== "recording" && !["idle", "ended", "failed", "starting"].includes(facts.stream),
      behind: facts.hasFrame && facts.source !== "recording" && (facts.mode === "replay" || facts.isBehind),
      replay: facts.hasFrame && facts.source === "recording" && facts.mode !== "paused",
      paused: facts.hasFrame && facts.mode === "paused",
      preview: facts.hasFrame && facts.stream === "starting",
      stalled: facts.hasFrame && facts.isQuiet,
      ended: facts.isOver || (["idle", "ended"].includes(facts.stream) && (facts.mode === "live" || !facts.hasFrame)),
      waiting: !facts.hasFrame, connecting: facts.link === "opening", reconnecting: facts.link === "broken",
      failed: facts.stream === "failed", deleted: facts.verdict === "deleted", denied: facts.verdict === "denied",
    };
    assert.ok(needs[phase], `${phase} from ${JSON.stringify(facts)}`);
    if (facts.verdict) assert.equal(phase, facts.verdict);
    else if (facts.link !== "open") assert.ok(["connecting", "reconnecting"].includes(phase));
  }
  assert.deepEqual([...seen].sort(), ["behind", "connecting", "deleted", "denied", "ended", "failed", "live", "paused", "preview", "reconnecting", "replay", "stalled", "waiting"]);
});

/** Steps that a session can take, each at a time of its own. */
const STEPS = {
  hello: (s, now) => s.opened(now),
  starting: (s, now) => s.control(welcome({ state: "starting", window: null, progress: { fraction: 0.1, text: "step 1" } }), now),
  welcome: (s, now) => s.control(welcome(), now),
  recording: (s, now) => s.control(welcome({ source: "recording" }), now),
  old: (s, now) => s.control(welcome({ state: "ended" }), now),
  frame: (s, now) => { s.arrived(9, now); s.applied(s.status.window?.newest.version ?? 1, 1, now); },
  late: (s, now) => { s.arrived(9, now); s.applied(0, 1, now); },
  far: (s, now) => s.control(event("window", { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 999 } }), now),
  live: (s, now) => s.control(event("state", { state: "live", detail: "" }), now),
  end: (s, now) => s.control(event("state", { state: "ended", detail: "" }), now),
  fail: (s, now) => s.control(event("state", { state: "failed", detail: "" }), now),
  stop: (s, now) => s.control(event("state", { state: "idle", detail: "" }), now),
  pause: (s, now) => s.control(event("position", { mode: "paused", epoch: 1, version: 9 }), now),
  seek: (s, now) => s.control(event("position", { mode: "replay", epoch: 1, version: 3 }), now),
  edge: (s, now) => s.control(event("position", { mode: "live", epoch: 1, version: 9 }), now),
  caught: (s, now) => s.control(event("caught_up"), now),
  silence: (s, now) => s.tick(now + 5000),
  tick: (s, now) => s.tick(now),
  broken: (s, now) => s.closed(1006, "", now, 0.5),
  deleted: (s, now) => s.closed(1000, "the stream was deleted", now, 0.5),
  refused: (s, now) => s.closed(4401, "", now, 0.5),
};

test("phase: every transition", () => {
  const walks = [
    "hello connecting, starting waiting, frame preview, live live, silence stalled, frame live, far behind, frame live, pause paused, silence paused, seek behind, caught live",
    "hello connecting, welcome waiting, frame live, end ended, live live, stop ended, live live, fail failed, live live, deleted deleted",
    "hello connecting, welcome waiting, frame live, broken reconnecting, broken reconnecting, hello reconnecting, welcome live, broken reconnecting, refused denied",
    "hello connecting, welcome waiting, frame live, silence stalled, broken reconnecting, hello reconnecting, starting waiting, silence waiting, frame preview, deleted deleted",
    "hello connecting, welcome waiting, silence waiting, frame live, silence stalled, pause paused, edge live, silence stalled, end ended, pause paused, seek behind, end behind, edge ended",
    "hello connecting, recording waiting, frame replay, silence replay, far replay, silence stalled, frame replay, pause paused, seek replay, end replay, edge ended, deleted deleted",
    "hello connecting, old waiting, frame ended, seek behind, pause paused, edge ended, broken reconnecting, hello reconnecting, old ended",
    "hello connecting, welcome waiting, frame live, seek behind, silence stalled, late behind, broken reconnecting, hello reconnecting, welcome behind",
    "hello connecting, fail connecting, welcome waiting, fail failed", "refused denied", "broken reconnecting, hello reconnecting, deleted deleted",
  ];
  for (const walk of walks) {
    const session = new Session(0);
    let now = 0;
    assert.equal(session.status.phase, "connecting");
    for (const step of walk.split(", ")) {
      const [name, wanted] = step.split(" ");
      STEPS[name](session, (now += 100));
      if (name === "silence") now += 5000;
      assert.equal(session.status.phase, wanted, `${step} in: ${walk}`);
    }
  }
});

test("session: what cannot be read ends it, what is unknown does not; a server of another version is named as that", () => {
  const wrong = ["", "{", "null", "5", "[]", "{}", JSON.stringify({ type: 3 }), JSON.stringify({ type: "x".repeat(1 << 20) }), welcome({ window: 5 }), welcome({ fps: "30" }),
    welcome({ levels: "3" }), welcome({ epoch: -1 }), welcome({ state: undefined }), welcome({ progress: { fraction: "all" } }),
    event("window", { oldest: null, newest: null }), event("position", { mode: "live", version: -1 }),
    event("state", {}), event("epoch", { epoch: null }), event("skipped", {}), event("levels", { levels: [] })];
  for (const text of wrong) {
    const session = new Session(0);
    session.opened(0);
    session.control(welcome());
    const { window, fps } = session.status;
    assert.equal(session.control(text), null, text);
    assert.deepEqual([session.status.phase, session.status.window, session.status.fps], ["failed", window, fps], text);
  }
  const session = new Session(0);
  for (const text of [event("weather", { rain: true }), JSON.stringify({ type: "toString" })]) {
    session.control(text);
    assert.equal(session.verdict, null);
  }
  session.control(JSON.stringify({ type: "welcome", version: 2, window: "other" }));
  assert.equal(session.status.phase, "version");
});

test("messages to thin viewers: the largest rig is taken, a malformed scene or answer is not", () => {
  const camera = { name: "\u00e9".repeat(32), width: 65535, height: 65535, intrinsics: new Array(9).fill(-1 / 3e7), world_to_camera: new Array(16).fill(-1 / 3e7) };
  const facts = { background: [0, 0.5, 1], fps: 30, levels: 3, view_dependent: false };
  const scene = (more) => event("scene", { ...facts, cameras: new Array(255).fill({ ...camera, ...more }) });
  const escaped = scene().replaceAll("\u00e9", "\\u00e9"); // as Python writes it
  assert.ok(escaped.length > 200_000);
  assert.equal(heard(escaped).cameras.length, 255);
  assert.equal(heard(event("scene", { ...facts, cameras: [] })).fps, 30);
  for (const point of [[-1, 0, 2.5], null]) assert.deepEqual(heard(event("picked", { id: 1, point, depth: 2 })).point, point);
  const wrong = [event("scene"), event("scene", { ...facts }), ...[5, null, {}, "all", [null], [5], [[]], [{}]].map((cameras) => event("scene", { ...facts, cameras })),
    scene({ name: 5 }), scene({ width: -1 }), scene({ intrinsics: new Array(8).fill(0) }), scene({ world_to_camera: { ...new Array(16).fill(0) } }),
    scene({ world_to_camera: new Array(16).fill(null) }), scene().replace(/-3[.0-9]+e-8/, "-1e999"), event("scene", { ...facts, background: { 0: 0, 1: 0, 2: 0 }, cameras: [] }),
    event("scene", { ...facts, view_dependent: 1, cameras: [] }), event("picked"), event("picked", { id: "1", point: null, depth: 0 }),
    event("picked", { id: 1, point: [1, 2], depth: 0 }), event("picked", { id: 1, point: "near", depth: 0 }), event("picked", { id: 1, point: null })];
  for (const text of wrong) {
    assert.equal(heard(text), null, text.slice(0, 200));
    const session = new Session(0);
    session.control(text);
    assert.equal(session.status.phase, "failed");
  }
});

test("session: a slow encoder is not a stall, a sudden silence is one", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome({ source: "data" }));
  let now = 0;
  for (let i = 0; i < 6; i++) {
    now += 4000;
    session.arrived(1, now);
    session.applied(10 + i, 1, now);
  }
  session.tick(now + 5000);
  assert.equal(session.status.phase, "live");
  session.tick(now + 40_000);
  assert.equal(session.status.phase, "stalled");
});

test("session: who joins a stream that has seconds between its frames waits for the second one", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome({ window: { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 10 }, newest_time_ns: 80_000_000_000 } }));
  session.arrived(1, 100);
  session.applied(0, 1, 100, 0); // the keyframe
  session.arrived(1, 110);
  session.applied(10, 1, 110, 80_000);
  session.tick(15_000);
  assert.equal(session.status.phase, "live");
  session.tick(40_000);
  assert.equal(session.status.phase, "stalled");
});

test("session: a stream of which there is one frame is not overdue at once", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome({ window: { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 0 }, newest_time_ns: 0 } }));
  session.arrived(1, 100);
  session.applied(0, 1, 100, 0);
  session.tick(9000);
  assert.equal(session.status.phase, "live");
  session.tick(11_000);
  assert.equal(session.status.phase, "stalled");
});

test("session: a first frame that took minutes is not overdue when it is whole", () => {
  const session = new Session(0);
  session.opened(0);
  session.control(welcome({ state: "starting" }));
  session.arrived(1, 100);
  session.applied(1, 1, 100, 0);
  session.tick(300_000);
  assert.equal(session.status.phase, "preview");
  session.control(event("state", { state: "live", detail: "" }), 300_500);
  assert.equal(session.status.phase, "live");
  session.tick(301_000);
  assert.equal(session.status.phase, "live");
  session.tick(320_000);
  assert.equal(session.status.phase, "stalled");
});

test("session: recorded frames that lie far apart are not overdue before their time", () => {
  const session = new Session(0);
  session.opened(0);
  const window = { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 30 }, newest_time_ns: 300_000_000_000 };
  session.control(welcome({ source: "cameras", window }));
  session.control(event("position", { mode: "replay", version: 10 }));
  session.arrived(1, 1000);
  session.applied(10, 1, 1000, 120_000); // 20 more in three minutes
  session.tick(10_000);
  assert.equal(session.status.phase, "behind");
  session.tick(50_000);
  assert.equal(session.status.phase, "stalled");
});

test("session: a recording that the server plays is not overdue while nobody has its next frame", () => {
  const session = new Session(0), places = (/** @type {number} */ version) => ({ oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version } });
  session.opened(0);
  session.control(welcome({ source: "recording", window: null }));
  session.applied(1, 1, 0, 0);
  session.tick(9000);
  assert.equal(session.status.phase, "replay", "no word of the newest came yet");
  session.control(event("window", places(0)), 10_000); // of before this one
  session.tick(50_000);
  assert.equal(session.status.phase, "replay");
  session.control(event("window", places(2)), 50_500);
  session.tick(50_600);
  assert.equal(session.status.phase, "stalled", "there is one, but it does not come");
  session.control(event("window", places(1)), 51_000);
  session.tick(61_000);
  assert.equal(session.status.phase, "stalled", "that is too long for any");
});

test("session: the welcome tells the progress of the first frame and the server's clock", () => {
  const session = new Session(0);
  session.opened(1000);
  session.control(welcome({ state: "starting", window: null, progress: { fraction: 0.3, loss: null, text: "step 3" }, server_time_ns: 5_000_000_000 }), 1040, 7000);
  assert.deepEqual([session.status.fraction, session.status.stage, session.status.trouble], [0.3, "step 3", ""]);
  session.control(event("state", { state: "starting", detail: "a and b are exchanged" }));
  assert.equal(session.status.trouble, "a and b are exchanged", "and no picture of it is what was filmed");
  assert.equal(session.status.clockMs, 5000 - 6980, "the server wrote it in the middle of the round trip");
});

test("session: final close codes are not tried again, a refused packet is at once", () => {
  for (const [code, phase] of [[1000, "deleted"], [4401, "denied"], [4403, "denied"], [4404, "missing"], [4415, "version"], [4400, "failed"], [1009, "failed"]]) {
    const session = new Session(0);
    assert.equal(session.closed(code, "why", 0, 0.5), null);
    assert.deepEqual([session.status.phase, session.status.detail], [phase, "why"]);
  }
  const session = new Session(0);
  session.refused++;
  assert.equal(session.closed(4400, "", 0, 0.5), 0);
  session.refused++;
  assert.ok(session.closed(4400, "", 0, 0.5) >= 500);
});

const PHASES = ["connecting", "waiting", "preview", "live", "behind", "replay", "paused", "stalled", "reconnecting", "ended", "deleted", "failed",
  "version", "denied", "missing"];

test("every phase has words, and none stands in the way of a picture without need", () => {
  const { status } = new Session(0);
  for (const phase of PHASES) {
    const bare = words({ ...status, phase }, false, 2500), shown = words({ ...status, phase }, true, 2500);
    assert.ok(bare.chip && shown.chip, phase);
    assert.equal(shown.card !== null, ["failed", "version", "denied", "missing"].includes(phase), phase);
  }
  assert.match(words({ ...status, phase: "reconnecting" }, true, 2500).chip, /3 s/);
  assert.equal(words({ ...status, phase: "live", source: "data" }, true, 0).tone, "good", "red is for live cameras");
  assert.equal(words({ ...status, phase: "behind", lagSeconds: 3.21 }, true, 0).chip, "3.2 s behind live");
  assert.equal(words({ ...status, phase: "preview", fraction: 0.42 }, true, 0).chip, "Preview, trained to 42 %");
  const window = { oldest: { epoch: 1, version: 0 }, newest: { epoch: 1, version: 9 } };
  assert.equal(words({ ...status, phase: "ended", window }, false, 0).card.title, "Loading", "an end is told after the last picture");
  assert.equal(words({ ...status, phase: "live", trouble: "camera cam01 is lost" }, true, 0).chip, "Live, but camera cam01 is lost");
  assert.equal(words({ ...status, phase: "preview", fraction: 0.42, trouble: "a and b are exchanged" }, true, 0).chip, "Preview, trained to 42 %, but a and b are exchanged");
  assert.equal(words({ ...status, phase: "stalled", trouble: "a and b are exchanged" }, true, 0).chip, "No new frames: a and b are exchanged");
  assert.ok(words({ ...status, phase: "live", trouble: "x".repeat(5000) }, true, 0).chip.length < 450);
  assert.equal(words({ ...status, phase: "behind", lagSeconds: 449.4 }, true, 0).chip, "7:29 behind live");
  assert.equal(clock(123.16), "2:03.1");
  assert.deepEqual([3.21, 9.97, 48.2, 449.4].map(duration), ["3.2 s", "10 s", "48 s", "7:29"]);
});

test("outside of what the rig has seen: free in front, gone behind and far away, held before one is lost", () => {
  const rig = [-0.7, 0, 0.7].map((angle) => {
    const c = Math.cos(angle), s = Math.sin(angle), eye = [3 * s, 0, -3 * c];
    const r = [c, 0, s, 0, 1, 0, -s, 0, c]; // looks at the origin
    const t = [0, 1, 2].map((i) => -(r[3 * i] * eye[0] + r[3 * i + 1] * eye[1] + r[3 * i + 2] * eye[2]));
    return { name: "", width: 4, height: 3, intrinsics: [3, 0, 2, 0, 3, 1.5, 0, 0, 1], worldToCamera: [...r.slice(0, 3), t[0], ...r.slice(3, 6), t[1], ...r.slice(6), t[2], 0, 0, 0, 1] };
  });
  const space = seenSpace(rig, [0, 0, 0]);
  near([space.radius, outside(space, [0, 0, -3]), outside(space, [0.5, -0.5, -2]), outside(space, [0, 0, 0.1]), outside(space, [0, 0, 3])], [3, 0, 0, 0, 1]);
  const half = outside(space, [0, 0, -7]);
  assert.ok(half > 0.2 && half < 0.6);
  near(held(space, { ...POSE, position: [0, 0, -100] }).position, [0, 0, -12]);
  assert.deepEqual(held(space, POSE), POSE);
});

/** A screen that draws at a given rate, and what is told to the worker. */
function screen(fps) {
  const told = [];
  const viewer = { fps, told, resolution: 1, share: 1, levels: Infinity, painter: {}, pace: { sustained: () => viewer.fps }, resize() {}, viewChanged() {}, tell: (message) => told.push(message) };
  return viewer;
}

test("auto gives up resolution, then splats, at once where frames are late, and takes them back; levels it never gives up", () => {
  const viewer = screen(60), quality = new Quality(viewer, null);
  quality.limit(4);
  for (let i = 0; i < 30; i++) quality.tick();
  assert.deepEqual([viewer.resolution, viewer.share], [1, 1]);
  quality.frame(120);
  assert.equal(viewer.resolution, 1, "one late frame may be chance");
  quality.frame(120);
  assert.deepEqual([viewer.resolution, viewer.share], [0.75, 1]);
  quality.frame(500);
  quality.frame(500);
  assert.equal(viewer.resolution, 0.75, "the first frames after a step were begun before it");
  quality.frame(500);
  quality.frame(500);
  assert.deepEqual([viewer.resolution, viewer.share], [0.5, 0.5], "far too slow: two steps at once");
  quality.frame(20);
  quality.frame(20);
  viewer.fps = 12;
  quality.tick();
  assert.equal(viewer.share, 0.4);
  quality.frame(20);
  quality.frame(20);
  viewer.fps = 60;
  for (let i = 0; i < 400; i++) {
    quality.tick();
    quality.frame(16);
  }
  assert.deepEqual([viewer.resolution, viewer.share], [1, 1]);
  quality.frame(800, true);
  assert.deepEqual([viewer.resolution, viewer.share], [0.35, 0.3], "a slow picture at rest tells what the next movement can afford");
  assert.deepEqual(viewer.told, []);
});

test("low asks for one level less, high for all", () => {
  const viewer = screen(60), quality = new Quality(viewer, "low");
  quality.limit(3);
  assert.deepEqual([quality.wishes(), viewer.resolution], [{ levels: 2 }, 0.75]);
  viewer.fps = 1;
  quality.tick();
  assert.deepEqual([viewer.resolution, viewer.share], [0.6, 0.7], "low is auto with a lower ceiling");
  quality.choose("high");
  for (let i = 0; i < 10; i++) {
    quality.tick();
    quality.frame(900);
  }
  assert.deepEqual([quality.wishes(), viewer.resolution, viewer.share], [{ levels: null }, 1, 1]);
});

test("a flight goes to one end of the rig, to the other, and back", () => {
  const eye = (/** @type {number} */ angle) => {
    const forward = [-Math.sin(angle), 0, Math.cos(angle)], right = [Math.cos(angle), 0, Math.sin(angle)];
    const at = [3 * Math.sin(angle), 0, -3 * Math.cos(angle)], rows = [right, [0, 1, 0], forward];
    const m = rows.flatMap((r) => [...r, -(r[0] * at[0] + r[1] * at[1] + r[2] * at[2])]);
    return { name: `at ${angle}`, width: 320, height: 180, intrinsics: [200, 0, 160, 0, 200, 90, 0, 0, 1], worldToCamera: [...m, 0, 0, 0, 1] };
  };
  const cameras = [-0.4, 0, 0.7].map(eye), up = rigUp(cameras), pose = camera.fromCamera(cameras[1], 3);
  const space = seenSpace(cameras, camera.target(pose)), [left, right] = turns(space, pose, up);
  assert.ok(Math.abs(spread(space) - 0.6) < 0.07, String(spread(space)));
  assert.deepEqual([Math.min(-left, right), Math.max(-left, right)].map((x) => x.toFixed(2)), ["0.36", "0.63"]);
  for (const turn of [left, right]) assert.equal(outside(space, camera.orbit(pose, up, turn, 0).position), 0, "never outside of the rig");
  assert.ok([0, 0.5, 1].every((t) => Math.abs(turnAt(t, [left, right])) < 1e-9));
  const way = Array.from({ length: 101 }, (_, i) => turnAt(i / 100, [left, right]));
  assert.ok(Math.abs(Math.max(...way) - right) < 0.01 && Math.abs(Math.min(...way) - left) < 0.01);
  let far = pose;
  for (let i = 0; i < 200; i++) far = braked(space, far, camera.orbit(far, up, 0.05, 0));
  assert.ok(outside(space, far.position) < 0.95, "it takes ever more force to leave the rig");
});

test("Auto that is too slow even with the fewest splats moves the last picture, and takes that back", () => {
  let pace = null;
  const viewer = { painter: { warps: false }, resize() {}, tell() {}, viewChanged() {}, pace: { sustained: () => pace } }, quality = new Quality(/** @type {any} */ (viewer), null);
  for (let i = 0; i < 40 && !quality.isTooSlow; i++) quality.frame(300);
  assert.ok(quality.isTooSlow && viewer.painter.warps);
  assert.match(quality.explain(), /last picture/);
  pace = 60;
  for (let i = 0; i < 60; i++) {
    quality.frame(10);
    quality.tick();
  }
  assert.ok(!quality.isTooSlow && !viewer.painter.warps);
});

/** A matrix of 16 numbers, column by column, on a direction (w = 0) or a place (w = 1). */
const applied = (m, [x, y, z], w) => [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i] * w);

test("a rig of any axes stands upright in an engine's scene, and its cameras look along -z", () => {
  const rows = [[0, 1, 0], [0, 0, -1], [-1, 0, 0]]; // right is y, down is -z, forward is -x
  const place = [4, 1, 2], m = rows.flatMap((r) => [...r, -(r[0] * place[0] + r[1] * place[1] + r[2] * place[2])]);
  const rig = [{ name: "a", width: 320, height: 180, intrinsics: [90, 0, 160, 0, 90, 90, 0, 0, 1], worldToCamera: [...m, 0, 0, 0, 1] }];
  const matrix = upright(rig), { pose, fov } = viewOf(rig[0]);
  near(applied(matrix, [0, 0, 1], 0), [0, 1, 0]);
  near(applied(matrix, [-1, 0, 0], 0), [0, 0, -1]);
  near(applied(matrix, [0, 1, 0], 0), [1, 0, 0]);
  near(applied(pose, [0, 0, 0], 1), place);
  near(applied(matrix, applied(pose, [0, 0, -1], 0), 0), [0, 0, -1]);
  near(applied(matrix, applied(pose, [0, 1, 0], 0), 0), [0, 1, 0]);
  near([fov], [90]);
  near(applied(upright([]), [0, -1, 0], 0), [0, 1, 0]);
});

test("straight down or up, a rig still has a rotation to stand upright by", () => {
  for (const down of [[0, 0, 1], [0, 1, 0], [0.6, 0, 0.8]]) {
    const [x, y, z] = down, m = [0, 0, 0, 0, x, y, z, 0, x, y, z, 0]; // as if it looked along its own down
    const matrix = upright([{ name: "a", width: 1, height: 1, intrinsics: [1, 0, 0, 0, 1, 0, 0, 0, 1], worldToCamera: [...m, 0, 0, 0, 1] }]);
    const [a, b, c] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => applied(matrix, axis, 0));
    near([a, b, c].map((v) => Math.hypot(...v)), [1, 1, 1]);
    near(cross(a, b), c);
    near(applied(matrix, down, 0), [0, -1, 0]);
  }
});

test("a live stream is followed from what it shows now until the signal, or until a frame cannot be taken", async () => {
  const live = Object.assign(new EventTarget(), { frame: async () => ({ version: 3, count: 5, changes: [] }) });
  const stop = new AbortController(), versions = [];
  const come = (version) => live.dispatchEvent(Object.assign(new Event("frame"), { detail: { version, changes: [{ first: 0, count: 1 }] } }));
  const ended = follow(/** @type {any} */ (live), ({ version, changes }) => versions.push([version, changes[0].count]), stop.signal);
  await new Promise((resolve) => setImmediate(resolve));
  come(4);
  stop.abort();
  come(5);
  await ended;
  assert.deepEqual(versions, [[3, 5], [4, 1]], "the first is new as a whole");
  const failed = follow(/** @type {any} */ (live), ({ version }) => {
    if (version === 6) throw new Error("full");
  });
  await new Promise((resolve) => setImmediate(resolve));
  come(6);
  await assert.rejects(failed, /full/);
});

test("a recording is followed in its own time, over and over", async () => {
  const stop = new AbortController(), seconds = [];
  const clip = { times: [0, 0.02], duration: 0.02, scene: { fps: 50 }, frame: async (at) => ({ at, count: 1, changes: at < 0.02 ? [] : [{ first: 0, count: 1 }] }) };
  await follow(/** @type {any} */ (clip), ({ at }) => {
    seconds.push(at);
    if (seconds.length === 8) stop.abort();
  }, stop.signal);
  assert.equal(seconds[0], 0);
  assert.ok(seconds.slice(1).every((at) => at >= 0.02 && at < 0.04), "frames in which nothing changed are not handed over");
});

test("the server's clock is known to half of the shortest way there and back, and drifts with time", () => {
  const clock = new ServerClock(), truth = 1_790_000_000_000;
  assert.ok(Number.isNaN(clock.at(0)));
  clock.add(0, 30, truth + 25); // a slow way there: 10 ms wrong
  clock.add(100, 104, truth + 102);
  clock.add(200, 260, truth + 205);
  clock.add(300, 290, truth + 205); // an answer before its question
  assert.equal(clock.count, 3);
  near([clock.at(300) - truth, clock.errorAt(104)], [300, 2], 1e-3);
  assert.ok(clock.errorAt(60_104) > 4.9 && clock.errorAt(60_104) < 5.1); // 50 ppm for a minute
  clock.add(600_000, 600_008, truth + 600_104); // ten minutes later the clocks are 100 ms apart
  near([clock.at(600_010) - truth], [600_110], 1e-3);
});

test("a pushed picture is packed as the server reads it", () => {
  const hex = Buffer.from(pack("c", 7, 1_790_000_000_000.25, "jpeg", new Uint8Array([255]))).toString("hex");
  const header = "84d90663616d657261d90163d90873657175656e6365cf0000000000000007d90a636170747572655f6e73cf18d75b8423f6d090d905636f646563d9046a706567";
  assert.equal(hex, (header.length / 2).toString(16).padStart(4, "0") + header + "ff");
});

test("of a picture of another shape the middle is sent, of one that lies on its side nothing", () => {
  const size = (width, height) => ({ width, height });
  assert.deepEqual(part(size(1280, 720), size(640, 360)), { x: 0, y: 0, width: 1280, height: 720 });
  assert.deepEqual(part(size(640, 480), size(1280, 720)), { x: 0, y: 60, width: 640, height: 360 });
  assert.deepEqual(part(size(720, 1280), size(360, 640)), { x: 0, y: 0, width: 720, height: 1280 });
  assert.equal(part(size(720, 1280), size(1280, 720)), null);
  assert.equal(part(size(0, 0), size(1280, 720)), null);
});

test("a camera is slow where a second's count is short by more than one picture", () => {
  for (const [rate, wanted] of [[7, 8], [8.9, 8], [4.4, 5], [28.4, 30], [0, 8], [0.4, 1]]) assert.ok(!isSlow(rate, wanted), `${rate}`);
  for (const [rate, wanted] of [[5, 8], [3, 5], [24, 30]]) assert.ok(isSlow(rate, wanted), `${rate}`);
});

test("who names no stream sees the live cameras, else what is live, else the first", () => {
  const made = (...kinds) => kinds.map(([source, state], id) => ({ id: String(id), source, state }));
  const played = ["recording", "live"], ended = ["cameras", "ended"], filmed = ["cameras", "live"];
  assert.equal(foremost(made(played, ended, filmed, filmed)).id, "2");
  assert.equal(foremost(made(ended, played)).id, "1");
  assert.equal(foremost(made(ended, ["data", "failed"])).id, "0");
  assert.equal(foremost([]), undefined);
});
