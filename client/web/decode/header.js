/** What a scene has beside its anchors: the HEADER and WEIGHTS chunks, codec/FORMAT.md sections 4 and 5. */

import { Chunk, LIMITS, must, Reader } from "./packet.js";
import { emptyLevel, HIDDEN } from "./scene.js";

/** @typedef {import("./packet.js").Packet} Packet */
/** @typedef {import("./scene.js").Header} Header */
/** @typedef {import("./scene.js").RigCamera} RigCamera */
/** @typedef {import("./scene.js").Scene} Scene */

/** @type {(header: Uint8Array, weights: Uint8Array, packet: Packet) => Scene} */
export function readScene(headerChunk, weightsChunk, { keyframe, identifier, chunks }) {
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

/** @type {(reader: Reader) => RigCamera} */
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
  const rows = [0, 4, 8].map((at) => m.slice(at, at + 3)),
    [x, y, z] = rows;
  const product = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const orthonormal = rows.every((a, i) => rows.every((b, j) => Math.abs(product(a, b) - Number(i === j)) <= 1e-3));
  const across = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
  return orthonormal && product(across, z) > 0;
}
