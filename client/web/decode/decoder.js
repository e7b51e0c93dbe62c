/** Packets into a scene, codec/FORMAT.md section 3. A packet that is refused changes nothing. */

import { decodeChange, decodeRemoved, noChange } from "./change.js";
import { digest } from "./checksum.js";
import { decodeGeometry } from "./geometry.js";
import { readScene } from "./header.js";
import { Chunk, KEY, levelBytes, LIMITS, must, parsePacket, Reader } from "./packet.js";
import { decodeAdded, decodeBase } from "./rows.js";
import { changed, emptyLevel, joined, rowBytes } from "./scene.js";

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
    const scene = fresh ? readScene(headerChunk, weightsChunk, packet) : held(this.scene, packet),
      { header } = scene;
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
  return { rows: joined(change.rows, removed), level: next };
}

/** The scene that a packet needs. @type {(scene: Scene | null, packet: Packet) => Scene} */
function held(scene, { keyframe, identifier }) {
  must(scene, "no_keyframe");
  must(scene.keyframe === keyframe && scene.identifier === identifier, "unknown_keyframe");
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
