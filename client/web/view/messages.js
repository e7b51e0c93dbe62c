/**
 * What page and worker say to each other; types only.
 *
 * @typedef {import("../stream/session.js").Status} Status
 * @typedef {import("../stream/session.js").Position} Position
 * @typedef {import("./camera.js").RigCamera} RigCamera
 * @typedef {import("./camera.js").Vec3} Vec3
 * @typedef {{ levels?: number | null, kilobytes_per_second?: number | null }} Wishes
 *
 * @typedef {{ type: "connect", live: string | null, file: string | null, token: string | null, wishes: Wishes }
 *   | { type: "view", view: import("./engine.js").EngineView }
 *   | { type: "send", messages: object[] }
 *   | { type: "wishes", wishes: Wishes }
 *   | { type: "listen", on: boolean }
 *   | { type: "hurry" } | { type: "texture" } | { type: "close" }
 *   | { type: "pick" | "depth", id: number, origin: Vec3, direction: Vec3 }
 *   | { type: "inspect", id: number }} ToWorker
 *
 * @typedef {{ version: number, versions: number[], digests: number[], splats: Float32Array }} Inspection
 *
 * @typedef {{ type: "picture", timeMs?: number, decodeMs: number, position: Position | null,
 *   overMs?: number | null, drawn?: { width: number, height: number, quality: number } }
 *   & import("./engine.js").Picture} PictureMessage
 *
 * @typedef {{ cameras: RigCamera[], background: [number, number, number], fps: number, levels: number, viewDependent: boolean, exposures?: number[][] }} SceneFacts
 *
 * @typedef {PictureMessage
 *   | ({ type: "scene" } & SceneFacts)
 *   | { type: "status", status: Status, refusals: number, now: number }
 *   | { type: "refused", code: string, detail: string }
 *   | { type: "heard", piece: ArrayBuffer }
 *   | { type: "moments", moments: { version: number, timeMs: number }[] }
 *   | { type: "picked", id: number, point: Vec3 | null }
 *   | { type: "inspected", id: number, state: Inspection | null }} FromWorker
 */
export {};
