/**
 * Splats on a canvas of its own with WebGPU: compute shaders project them (project.wgsl) and sort them (radix.wgsl) for
 * every picture, quads are drawn as many as there are then (quads.wgsl). The rules are those of renderer.js.
 */

import { RECORD, ROW_SPLATS } from "../decode/expand.js";
import { NEUTRAL } from "./exposure.js";
import { GpuSort, QUADS, shader } from "./gpusort.js";
import { MAX_BLUR, MAX_KEEP, MIN_KEEP, quadVertices, Surface } from "./surface.js";

/** @typedef {import("./surface.js").View} View */
/** @typedef {{ project: GPUComputePipeline, draw: GPURenderPipeline, sort: GpuSort }} Programs */

const THREADS = 256; // of a workgroup of project.wgsl
const ROW_BYTES = 4 * RECORD * ROW_SPLATS;
const QUAD_BYTES = 32,
  VIEW_BYTES = 128; // as in project.wgsl
const MAX_GROUPS = 65_535; // of a dispatch
const OVER = /** @type {GPUBlendComponent} */ ({ srcFactor: "one", dstFactor: "one-minus-src-alpha" });

/**
 * @param {GPUAdapter} adapter
 * @param {HTMLCanvasElement} frame - the page's canvas, behind which the new one lies
 * @throws {Error} where it cannot be had after all
 */
export async function createGpuRenderer(adapter, frame) {
  const { maxBufferSize, maxStorageBufferBindingSize } = adapter.limits;
  const device = await adapter.requestDevice({ requiredLimits: { maxBufferSize, maxStorageBufferBindingSize } });
  try {
    const canvas = document.createElement("canvas"),
      context = canvas.getContext("webgpu"),
      format = navigator.gpu.getPreferredCanvasFormat();
    if (!context) throw new Error("no WebGPU canvas");
    context.configure({ device, format, alphaMode: "opaque" });
    const [toProject, toDraw, sort] = await Promise.all([
      shader(device, "project.wgsl"),
      shader(device, "quads.wgsl"),
      GpuSort.create(device),
    ]);
    const [project, draw] = await Promise.all([
      device.createComputePipelineAsync({
        layout: "auto",
        compute: { module: toProject, constants: { MAX_KEEP, MIN_KEEP, MAX_BLUR } },
      }),
      device.createRenderPipelineAsync({
        layout: "auto",
        vertex: { module: toDraw, constants: { QUADS } },
        fragment: { module: toDraw, targets: [{ format, blend: { color: OVER, alpha: OVER } }] },
      }),
    ]);
    const renderer = new GpuRenderer(frame, canvas, context, device, { project, draw, sort });
    renderer.hardware = `${adapter.info.vendor} ${adapter.info.architecture} ${adapter.info.description}`.trim();
    return renderer;
  } catch (error) {
    device.destroy();
    throw error;
  }
}

class GpuRenderer extends Surface {
  /**
   * @param {HTMLCanvasElement} frame
   * @param {HTMLCanvasElement} canvas
   * @param {GPUCanvasContext} context
   * @param {GPUDevice} device
   * @param {Programs} programs
   */
  constructor(frame, canvas, context, device, programs) {
    super(canvas);
    this.api = "WebGPU";
    this.sorts = true;
    this.frame = frame;
    this.context = context;
    this.device = device;
    this.programs = programs;
    this.count = 0;
    this.pictures = 0; // that are being drawn
    this.view = this.#make(VIEW_BYTES, GPUBufferUsage.UNIFORM);
    this.corners = this.#make(2 * 6 * QUADS, GPUBufferUsage.INDEX);
    device.queue.writeBuffer(this.corners, 0, quadVertices(QUADS));
    /** @type {GPUBuffer | null} */
    this.splats = null;
    /** @type {GPUBuffer | null} of the state before, once there was one to move on from */
    this.before = null;
    /** @type {{ shown: GPUBuffer, quads: GPUBuffer } | null} numbers of the splats to draw, and what becomes of them */
    this.drawn = null;
    /** @type {{ project: GPUBindGroup, draw: GPUBindGroup } | null} null: buffers were made anew */
    this.groups = null;
    this.ends = new Promise((resolve) => {
      this.end = resolve;
      device.lost.then(resolve);
      device.addEventListener("uncapturederror", resolve);
    });
    canvas.className = "surface";
    frame.before(canvas);
  }

  /** @param {number} size - bytes @param {number} usage */
  #make(size, usage) {
    this.groups = null;
    return this.device.createBuffer({ size, usage: usage | GPUBufferUsage.COPY_DST });
  }

  /** Whether the graphics card takes buffers of that many bytes; else this is the end. @param {number} bytes */
  #takes(bytes) {
    if (bytes <= this.device.limits.maxStorageBufferBindingSize) return true;
    this.end?.(undefined);
    return false;
  }

  /** @type {Surface["update"]} */
  update(rows, spans, overMs = null) {
    const { device } = this,
      { STORAGE, COPY_SRC } = GPUBufferUsage;
    if (overMs !== null) this.begin(overMs);
    if (!this.#takes(rows * ROW_BYTES)) return;
    if (rows > this.rows) {
      this.splats?.destroy();
      this.before?.destroy();
      this.splats = this.#make(rows * ROW_BYTES, STORAGE | COPY_SRC);
      this.before = null;
      this.rows = rows;
      this.movesFor = 0; // there is nothing to move on from
    } else if (overMs && this.splats) {
      this.before ??= this.#make(this.splats.size, STORAGE);
      const encoder = device.createCommandEncoder();
      encoder.copyBufferToBuffer(this.splats, 0, this.before, 0, this.splats.size);
      device.queue.submit([encoder.finish()]);
    }
    for (const { first, data } of spans)
      device.queue.writeBuffer(/** @type {GPUBuffer} */ (this.splats), first * ROW_BYTES, /** @type {any} */ (data));
  }

  /** @param {Uint32Array} order */
  setOrder(order) {
    const { sort } = this.programs,
      { STORAGE } = GPUBufferUsage;
    this.count = 0;
    if (!this.#takes(order.length * QUAD_BYTES) || order.length > MAX_GROUPS * THREADS) return this.end?.(undefined);
    if (sort.reserve(order.length) || !this.drawn) {
      this.drawn?.shown.destroy();
      this.drawn?.quads.destroy();
      this.drawn = { shown: this.#make(4 * sort.room, STORAGE), quads: this.#make(QUAD_BYTES * sort.room, STORAGE) };
    }
    this.count = order.length;
    if (this.count) this.device.queue.writeBuffer(this.drawn.shown, 0, /** @type {any} */ (order));
    sort.expect(this.count);
  }

  /** What the shaders read and write. */
  #bind() {
    const {
        device,
        programs: { project, draw, sort },
        splats,
        drawn,
      } = this,
      {
        unsorted: { keys, numbers },
        sorted,
      } = sort.buffers;
    const group = (/** @type {GPUPipelineBase} */ pipeline, /** @type {any[]} */ buffers) =>
      device.createBindGroup({
        layout: pipeline.getBindGroupLayout(0),
        entries: buffers.map((buffer, binding) => ({ binding, resource: { buffer } })),
      });
    return (this.groups ??= {
      project: group(project, [this.view, splats, this.before ?? splats, drawn?.shown, keys, numbers, drawn?.quads]),
      draw: group(draw, [drawn?.quads, sorted.numbers, sort.sizes]),
    });
  }

  /** @param {View} view @param {number} width @param {number} height */
  #look(
    { rotation: r, translation: t, focal, principal, share = 1, range = 1, near = 0, lens = 0, exposure = NEUTRAL },
    width,
    height,
  ) {
    const numbers = new Float32Array(VIEW_BYTES / 4);
    numbers.set([
      r[0],
      r[1],
      r[2],
      t[0],
      r[3],
      r[4],
      r[5],
      t[1],
      r[6],
      r[7],
      r[8],
      t[2],
      width,
      height,
      ...focal,
      ...principal,
      share,
      range,
      ...exposure.slice(0, 3),
      this.moved,
      ...exposure.slice(3),
      this.spread,
      near,
      0,
      lens,
    ]);
    new Uint32Array(numbers.buffer)[29] = this.count;
    this.device.queue.writeBuffer(this.view, 0, numbers);
  }

  /** @param {View} view */
  draw(view) {
    const {
      device,
      canvas,
      frame: { width, height },
      programs: { project, draw, sort },
    } = this;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.advance();
    const encoder = device.createCommandEncoder(),
      [r, g, b] = this.behind(view);
    const groups = this.count && this.splats ? this.#bind() : null;
    if (groups) {
      this.#look(view, width, height);
      const pass = encoder.beginComputePass();
      pass.setPipeline(project);
      pass.setBindGroup(0, groups.project);
      pass.dispatchWorkgroups(Math.ceil(this.count / THREADS));
      sort.encode(pass);
      pass.end();
    }
    const pass = encoder.beginRenderPass({
      colorAttachments: [
        {
          view: this.context.getCurrentTexture().createView(),
          loadOp: "clear",
          storeOp: "store",
          clearValue: { r, g, b, a: 1 },
        },
      ],
    });
    if (groups) {
      pass.setPipeline(draw);
      pass.setBindGroup(0, groups.draw);
      pass.setIndexBuffer(this.corners, "uint16");
      pass.drawIndexedIndirect(sort.sizes, 0);
    }
    pass.end();
    device.queue.submit([encoder.finish()]);
    this.#wait();
  }

  async #wait() {
    this.pictures++;
    await this.device.queue.onSubmittedWorkDone().catch(() => {}); // without a graphics card there is nothing to wait for
    this.pictures--;
  }

  get waiting() {
    return this.pictures;
  }

  destroy() {
    this.context.unconfigure();
    this.canvas.remove();
    this.device.destroy(); // and all that belongs to it
  }
}
