/** What draws a stream on this device: WebGPU where there is a graphics card for it, else WebGL2. */

import { Renderer } from "./renderer.js";

/** @typedef {{ renderer: import("./surface.js").Surface, worker: Worker | import("./thin.js").ThinLink }} Drawing */

const startWorker = () => new Worker(new URL("./worker.js", import.meta.url), { type: "module" });

/** With WebGL2. @param {HTMLCanvasElement} canvas @returns {Drawing} @throws {Error} without it */
export const drawWithWebgl = (canvas) => ({ renderer: new Renderer(canvas), worker: startWorker() });

/**
 * With the best there is.
 * @param {HTMLCanvasElement} canvas
 * @param {string | null} wanted - "0": without WebGPU; "1": with it even where it is emulated in software, which is slow
 * @returns {Promise<Drawing>}
 * @throws {Error} where there is nothing to draw with
 */
export async function drawHere(canvas, wanted) {
  const worker = startWorker(); // loads meanwhile
  try {
    return { renderer: (await gpuRenderer(canvas, wanted)) ?? new Renderer(canvas), worker };
  } catch (error) {
    worker.terminate();
    throw error;
  }
}

/** @param {HTMLCanvasElement} canvas @param {string | null} wanted */
async function gpuRenderer(canvas, wanted) {
  if (wanted === "0" || !navigator.gpu) return null;
  try {
    const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
    if (!adapter || (adapter.info.isFallbackAdapter && wanted !== "1")) return null;
    const { createGpuRenderer } = await import("./webgpu.js");
    return await createGpuRenderer(adapter, canvas);
  } catch {
    return null; // browsers differ in what they refuse, and how
  }
}
