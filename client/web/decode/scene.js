/** The integer state that travels, as in core/scene: levels of anchors, keyframes, residuals. */

export const LATENTS = 24,
  FEATURE_LATENTS = 12,
  HIDDEN = 32,
  SCALINGS = 6;

/**
 * @typedef {object} RigCamera
 * @property {string} name
 * @property {number[]} intrinsics - 9 numbers, row by row, pixels
 * @property {number[]} worldToCamera - 16 numbers, row by row
 * @property {number} width
 * @property {number} height
 */

/**
 * @typedef {object} Header
 * @property {number[]} origin - 3 world coordinates of voxel (0, 0, 0)
 * @property {number} rootCell - world units
 * @property {number} levels
 * @property {number} slots - Gaussians an anchor, K
 * @property {boolean} viewDependent
 * @property {number} referenceDistance - world units
 * @property {Float32Array} positionSteps - one a level
 * @property {Float32Array} featureSteps - F
 * @property {Float32Array} offsetSteps - 3K
 * @property {Float32Array} scalingSteps - 6
 * @property {Float32Array} background - RGB in [0, 1]
 * @property {number} fps
 * @property {RigCamera[]} cameras
 */

/**
 * @typedef {object} Weights
 * @property {Float32Array} hiddenWeight - [I, 32]
 * @property {Float32Array} hiddenBias - [32]
 * @property {Float32Array} outputWeight - [32, 11K]
 * @property {Float32Array} outputBias - [11K]
 * @property {Float32Array} featureDecoder - [12, F]
 * @property {Float32Array} offsetDecoder - [12, 3K]
 */

/**
 * Anchors of one level; rows are only ever appended and keep their number until the next keyframe.
 * @typedef {object} Level
 * @property {number} count
 * @property {Int32Array} voxel - [N, 3]
 * @property {Int32Array} position - [N, 3] offset from the node in position steps
 * @property {Int16Array} feature - [N, F]
 * @property {Int16Array} offset - [N, 3K]
 * @property {Int16Array} scaling - [N, 6]
 * @property {Int16Array} extraLevel - [N]
 * @property {Int16Array} latent - [N, 24]
 * @property {Uint8Array} alive - [N]
 */

/**
 * @typedef {object} Scene
 * @property {Header} header
 * @property {Weights} weights
 * @property {Level[]} levels
 * @property {number[]} versions - one a level, -1 where the level is absent
 * @property {number} keyframe
 * @property {bigint} identifier - of the keyframe; no other has it
 * @property {Uint8Array | undefined} metadata - facts about the scene, for `readMetadata`
 */

/**
 * Changes of one level: by how much [n, 3], [n, 24] which `rows` differ, which die, which come.
 * @typedef {{ rows: Uint32Array, position: Int32Array, latent: Int32Array, removed: Uint32Array, added: Level | null }} LevelChange
 */

/** Bytes that are refused; `code` as in codec/FORMAT.md. */
export class BitstreamError extends Error {
  /** @param {string} code @param {string} detail */
  constructor(code, detail) {
    super(detail);
    this.code = code;
  }
}

/** @type {(features: number, slots: number, count?: number) => Level} */
export function emptyLevel(features, slots, count = 0) {
  return {
    count,
    voxel: new Int32Array(3 * count),
    position: new Int32Array(3 * count),
    feature: new Int16Array(features * count),
    offset: new Int16Array(3 * slots * count),
    scaling: new Int16Array(SCALINGS * count),
    extraLevel: new Int16Array(count),
    latent: new Int16Array(LATENTS * count),
    alive: new Uint8Array(count),
  };
}

/** @template {Int32Array | Int16Array | Uint8Array | Uint32Array} A @param {A} first @param {A} second @returns {A} */
export function joined(first, second) {
  const result = new /** @type {any} */ (first.constructor)(first.length + second.length);
  result.set(first);
  result.set(second, first.length);
  return result;
}

/** Memory of a row of a level. @type {(features: number, slots: number) => number} */
export const rowBytes = (features, slots) => 87 + 2 * features + 6 * slots;

/** The rows of `first`, then those of `second`. @type {(first: Level, second: Level) => Level} */
function appendRows({ count, ...first }, second) {
  const columns = Object.entries(first).map(([name, column]) => [
    name,
    joined(column, second[/** @type {keyof typeof first} */ (name)]),
  ]);
  return { count: count + second.count, ...Object.fromEntries(columns) };
}

/**
 * The level after a change; the old one stays.
 * @type {(level: Level, change: LevelChange) => Level} @throws {BitstreamError} an integer leaves its type
 */
export function changed(level, { rows, position, latent, removed, added }) {
  const next = { ...level, position: level.position.slice(), latent: level.latent.slice(), alive: level.alive.slice() };
  for (let i = 0; i < rows.length; i++) {
    const p = 3 * rows[i],
      l = LATENTS * rows[i];
    for (let j = 0; j < 3; j++) {
      const sum = level.position[p + j] + position[3 * i + j];
      if (sum !== (sum | 0)) throw new BitstreamError("overflow", "a position leaves the range of int32");
      next.position[p + j] = sum;
    }
    for (let j = 0; j < LATENTS; j++) {
      const sum = level.latent[l + j] + latent[LATENTS * i + j];
      if (sum < -32768 || sum > 32767) throw new BitstreamError("overflow", "a latent leaves the range of int16");
      next.latent[l + j] = sum;
    }
  }
  for (let i = 0; i < removed.length; i++) next.alive[removed[i]] = 0;
  return added ? appendRows(next, added) : next;
}

/** The scene's version: the greatest of its levels'. @type {(scene: Scene) => number} */
export const versionOf = (scene) => Math.max(...scene.versions);

/** @type {(scene: Scene) => number} anchors alive on all levels */
export function anchorCount(scene) {
  let count = 0;
  for (const level of scene.levels) for (let i = 0; i < level.count; i++) count += level.alive[i];
  return count;
}
