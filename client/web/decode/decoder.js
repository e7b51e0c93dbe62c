/** Packets into a scene, codec/FORMAT.md section 3. A packet that is refused changes nothing. */

import { decodeChange, decodeRemoved, noChange } from "./change.js";
import { digest } from "./checksum.js";
import { decodeGeometry } from "./geometry.js";
import { Chunk, KEY, levelBytes, LIMITS, must, parsePacket, Reader } from "./packet.js";
import { decodeAdded, decodeBase } from "./rows.js";
import { changed, emptyLevel, HIDDEN, rowBytes } from "./scene.js";

/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./scene.js").Header} Header */
/** @typedef {import("./scene.js").Level} Level */
/** @typedef {import("./packet.js").Packet} Packet */

/**
 * What a packet did: a new scene, levels set whole (`rows` null), or rows of levels changed and others added, `from`
 * on.
 * @typedef {{ packet: Packet, scene: boolean, levels: { level: number, rows: Uint32Array | null, from: number }[] }} Effect
 */

export class SceneDecoder {
  constructor() {
    /** @type {Scene | null} */
    this.scene = null;
  }

  /** @param {Uint8Array} bytes - one packet @returns {Effect} @throws {import("./scene.js").BitstreamError} */
  push(bytes) {
    const packet = parsePacket(bytes);
    return packet.kind === KEY ? this.#key(packet) : this.#change(packet);
  }

  /** @param {Packet} packet @returns {Effect} */
  #key(packet) {
    const headerChunk = packet.chunks.get(Chunk.HEADER),
      weightsChunk = packet.chunks.get(Chunk.WEIGHTS);
    const fresh = headerChunk !== undefined && weightsChunk !== undefined;
    let scene = this.scene;
    if (fresh) {
      scene = readScene(headerChunk, weightsChunk, packet);
    } else scene = held(scene, packet);
    const { header } = scene;
    must(packet.mask >> header.levels === 0, "bad_scene_header");
    /** @type {[number, Level][]} */
    const built = [];
    let room =
      mostRows(header) - scene.levels.reduce((sum, level, l) => sum + ((packet.mask >> l) & 1 ? 0 : level.count), 0);
    for (const number of bitsOf(packet.mask)) {
      const geometry = packet.chunks.get((number << 4) | Chunk.GEOMETRY),
        base = packet.chunks.get((number << 4) | Chunk.BASE);
      const features = header.featureSteps.length;
      let level = emptyLevel(features, header.slots);
      if (geometry && base) {
        const own = { rows: room, bytes: levelBytes(packet, number) };
        const voxel = decodeGeometry(checked(geometry, packet), own);
        level = decodeBase(checked(base, packet), voxel, features, header.slots, own);
      }
      checkHash(packet.chunks.get((number << 4) | Chunk.HASH), level);
      room -= level.count;
      built.push([number, level]);
    }
    const next = { ...scene, levels: [...scene.levels], versions: [...scene.versions] };
    for (const [number, level] of built) {
      next.levels[number] = level;
      next.versions[number] = packet.keyframe;
    }
    this.scene = next;
    return { packet, scene: fresh, levels: built.map(([level]) => ({ level, rows: null, from: 0 })) };
  }

  /** @param {Packet} packet @returns {Effect} */
  #change(packet) {
    const scene = held(this.scene, packet);
    must(packet.mask >> scene.header.levels === 0, "bad_scene_header");
    const levels = bitsOf(packet.mask).filter((level) => scene.versions[level] === packet.fromVersion);
    must(levels.length, "version_mismatch");
    const next = { ...scene, levels: [...scene.levels], versions: [...scene.versions] };
    /** @type {Effect["levels"]} */
    const effects = [];
    for (const number of levels) {
      const room = mostRows(scene.header) - next.levels.reduce((sum, { count }) => sum + count, 0);
      const { rows, level } = changedLevel(packet, number, scene, room);
      effects.push({ level: number, rows, from: scene.levels[number].count });
      next.levels[number] = level;
      next.versions[number] = packet.toVersion;
    }
    this.scene = next;
    return { packet, scene: false, levels: effects };
  }
}

/** @type {(packet: Packet, number: number, scene: Scene, room: number) => { rows: Uint32Array, level: Level }} */
function changedLevel(packet, number, scene, room) {
  const { header } = scene,
    level = scene.levels[number];
  /** @type {(kind: number) => Uint8Array | undefined} */
  const chunk = (kind) => packet.chunks.get((number << 4) | kind);
  const [changeChunk, removedChunk, addedChunk, hashChunk] = [Chunk.CHANGE, Chunk.REMOVED, Chunk.ADDED, Chunk.HASH].map(
    chunk,
  );
  const { keyframe, fromVersion, toVersion } = packet;
  const elapsed = { age: fromVersion - keyframe, span: toVersion - fromVersion };
  const own = { rows: room, bytes: levelBytes(packet, number) };
  const change = changeChunk ? decodeChange(checked(changeChunk, packet), level, elapsed, own) : noChange();
  const removed = removedChunk ? decodeRemoved(checked(removedChunk, packet, false), level, own) : new Uint32Array(0);
  const added = addedChunk
    ? decodeAdded(checked(addedChunk, packet), header.featureSteps.length, header.slots, own)
    : null;
  const next = changeChunk || removedChunk || addedChunk ? changed(level, { ...change, removed, added }) : level;
  checkHash(hashChunk, next);
  const rows = new Uint32Array(change.rows.length + removed.length);
  rows.set(change.rows);
  rows.set(removed, change.rows.length);
  return { rows, level: next };
}

/** The scene that a packet needs. @type {(scene: Scene | null, packet: Packet) => Scene} */
function held(scene, { keyframe, identifier }) {
  must(scene, "no_keyframe");
  const same = scene.keyframe === keyframe && scene.identifier === identifier;
  must(same, "unknown_keyframe");
  return scene;
}

/** The most rows of all levels. @type {(header: Header) => number} */
const mostRows = ({ featureSteps, slots }) =>
  Math.min(
    LIMITS.anchors,
    Math.floor(LIMITS.gaussians / slots),
    Math.floor(LIMITS.stateBytes / rowBytes(featureSteps.length, slots)),
  );

/** @type {(chunk: Uint8Array | undefined, level: Level) => void} */
function checkHash(chunk, level) {
  if (!chunk) return;
  const reader = new Reader(chunk);
  const wanted = reader.u32();
  reader.end();
  must(digest(level) === wanted, "state_mismatch");
}

/** A chunk whose coding may occur there. @type {(chunk: Uint8Array, packet: Packet, coded?: boolean) => Uint8Array} */
function checked(chunk, { profile }, coded = true) {
  must(chunk.length > 0);
  const known = chunk[0] === 0 || (coded && profile > 0 && (chunk[0] === 1 || chunk[0] === 4));
  must(known, "unsupported_profile");
  return chunk;
}

/** @type {(mask: number) => number[]} */
const bitsOf = (mask) => Array.from({ length: 16 }, (_, i) => i).filter((i) => (mask >> i) & 1);

/** FORMAT.md sections 4 and 5. @type {(header: Uint8Array, weights: Uint8Array, packet: Packet) => Scene} */
function readScene(headerChunk, weightsChunk, { keyframe, identifier, chunks }) {
  const metadata = chunks.get(Chunk.METADATA)?.slice();
  const header = readHeader(headerChunk);
  const { slots, levels } = header,
    features = header.featureSteps.length;
  const reader = new Reader(weightsChunk, "bad_weights");
  const inputs = features + (header.viewDependent ? 4 : 0);
  const weights = {
    hiddenWeight: reader.f16(inputs * HIDDEN),
    hiddenBias: reader.f16(HIDDEN),
    outputWeight: reader.f16(HIDDEN * 11 * slots),
    outputBias: reader.f16(11 * slots),
    featureDecoder: reader.f16(12 * features),
    offsetDecoder: reader.f16(12 * 3 * slots),
  };
  reader.end();
  const empty = Array.from({ length: levels }, () => emptyLevel(features, slots));
  return { header, weights, levels: empty, versions: new Array(levels).fill(-1), keyframe, identifier, metadata };
}

/** @type {(chunk: Uint8Array) => Header} */
function readHeader(chunk) {
  const reader = new Reader(chunk, "bad_scene_header");
  const [levels, slots, features, viewDependent, cameraCount, ...reserved] = reader.take(8);
  const small = levels <= LIMITS.levels && slots <= LIMITS.slots && features <= LIMITS.features;
  must(small, "limit_exceeded");
  must(
    levels >= 1 && slots >= 1 && features >= 1 && viewDependent <= 1 && reserved.every((x) => x === 0),
    "bad_scene_header",
  );
  const origin = reader.f64(3);
  const [rootCell, referenceDistance, fps] = reader.f64(3);
  const background = reader.f32(3);
  const positionSteps = reader.f32(levels),
    featureSteps = reader.f32(features);
  const offsetSteps = reader.f32(3 * slots),
    scalingSteps = reader.f32(6);
  const lengths =
    [rootCell, referenceDistance].every((x) => x >= 1e-6 && x <= 1e9) && origin.every((x) => Math.abs(x) <= 1e9);
  const steps = [...positionSteps, ...featureSteps, ...offsetSteps, ...scalingSteps].every((x) => x > 0 && x <= 1e9);
  const others = fps >= 0.001 && fps <= 10000 && background.every((x) => x >= 0 && x <= 1);
  must(lengths && steps && others, "bad_scene_header");
  const cameras = Array.from({ length: cameraCount }, () => readCamera(reader));
  reader.end();
  return {
    origin,
    rootCell,
    levels,
    slots,
    viewDependent: viewDependent === 1,
    referenceDistance,
    positionSteps,
    featureSteps,
    offsetSteps,
    scalingSteps,
    background,
    fps,
    cameras,
  };
}

/** @type {(reader: Reader) => import("./scene.js").RigCamera} */
function readCamera(reader) {
  const length = reader.u8();
  must(length <= 64, "bad_scene_header");
  let name = "";
  try {
    name = new TextDecoder("utf-8", { fatal: true }).decode(reader.take(length));
  } catch {
    must(false, "bad_scene_header");
  }
  const width = reader.u32(),
    height = reader.u32();
  must(width >= 1 && width <= 65535 && height >= 1 && height <= 65535, "bad_scene_header");
  const intrinsics = reader.f64(9),
    worldToCamera = [...reader.f64(12), 0, 0, 0, 1];
  const distortion = reader.f64(5);
  const modest = [...intrinsics, ...worldToCamera, ...distortion].every((x) => Math.abs(x) <= 1e12);
  must(modest && intrinsics[0] > 0 && intrinsics[4] > 0 && isRotation(worldToCamera), "bad_scene_header");
  return { name, intrinsics, worldToCamera, width, height };
}

/** Whether the 3x3 part of a pose is one. @type {(m: number[]) => boolean} */
function isRotation(m) {
  const rows = [
    [m[0], m[1], m[2]],
    [m[4], m[5], m[6]],
    [m[8], m[9], m[10]],
  ];
  const product = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const orthonormal = rows.every((a, i) => rows.every((b, j) => Math.abs(product(a, b) - Number(i === j)) <= 1e-3));
  const [x, y, z] = rows;
  const across = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
  return orthonormal && product(across, z) > 0;
}
