/** Numbers in the order of their keys, on the graphics card (radix.wgsl). */

const THREADS = 256,
  ROUNDS = 16; // as in radix.wgsl
const SHIFTS = [0, 8, 16]; // of the digits that the passes sort by
const STEPS = ["count", "add", "scatter"];
const NUMBER = 4; // bytes
export const QUADS = 256; // that one instance draws

const USAGE = () => GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC;

/** @param {number} count - of keys */
const blocks = (count) => Math.ceil(count / (THREADS * ROUNDS));

/**
 * Text of a shader beside this module, compiled.
 * @type {(device: GPUDevice, name: string) => Promise<GPUShaderModule>}
 */
export async function shader(device, name) {
  const answer = await fetch(new URL(name, import.meta.url));
  if (!answer.ok) throw new Error(`${name} is missing`);
  return device.createShaderModule({ label: name, code: await answer.text() });
}

export class GpuSort {
  /** @param {GPUDevice} device @returns {Promise<GpuSort>} */
  static async create(device) {
    const module = await shader(device, "radix.wgsl"),
      { COMPUTE: visibility } = GPUShaderStage;
    const layout = device.createBindGroupLayout({
      entries: [0, 1, 2, 3, 4, 5].map((binding) => ({
        binding,
        visibility,
        buffer: { type: binding < 2 ? "read-only-storage" : "storage" },
      })),
    });
    const pipelines = SHIFTS.map((shift) =>
      Promise.all(
        STEPS.map((entryPoint) =>
          device.createComputePipelineAsync({
            layout: device.createPipelineLayout({ bindGroupLayouts: [layout] }),
            compute: {
              module,
              entryPoint,
              constants: { ...(entryPoint === "add" ? { QUADS } : { SHIFT: shift }), IS_FIRST: Number(shift === 0) },
            },
          }),
        ),
      ),
    );
    return new GpuSort(device, layout, await Promise.all(pipelines));
  }

  /** @param {GPUDevice} device @param {GPUBindGroupLayout} layout @param {GPUComputePipeline[][]} passes */
  constructor(device, layout, passes) {
    this.device = device;
    this.layout = layout;
    this.passes = passes;
    /**
     * Of the draw, as drawIndexedIndirect takes them; then how many keys there are, and how many of them are not left
     * out.
     */
    this.sizes = device.createBuffer({ size: 7 * NUMBER, usage: USAGE() | GPUBufferUsage.INDIRECT });
    this.count = 0;
    this.room = 1;
    this.buffers = this.#make(this.room);
  }

  /** @param {number} room */
  #make(room) {
    const { device, layout, sizes } = this,
      numbers = (/** @type {number} */ count) => device.createBuffer({ size: count * NUMBER, usage: USAGE() });
    const unsorted = { keys: numbers(room), numbers: numbers(room) }; // to be written; keys from 2^24 on must be LEFT_OUT
    const sorted = { keys: numbers(room), numbers: numbers(room) }; // where an odd number of passes leads
    const places = numbers(THREADS * blocks(room));
    const groups = [
      [unsorted, sorted],
      [sorted, unsorted],
    ].map(([from, to]) =>
      device.createBindGroup({
        layout,
        entries: [from.keys, from.numbers, to.keys, to.numbers, places, sizes].map((buffer, binding) => ({
          binding,
          resource: { buffer },
        })),
      }),
    );
    return { unsorted, sorted, places, groups };
  }

  /** Make room for that many keys. @param {number} count @returns {boolean} whether there are new buffers */
  reserve(count) {
    if (count <= this.room) return false;
    this.#free();
    this.room = Math.ceil(1.25 * count);
    this.buffers = this.#make(this.room);
    return true;
  }

  /** How many keys are to be sorted from now on. @param {number} count */
  expect(count) {
    this.device.queue.writeBuffer(this.sizes, 0, Uint32Array.of(6 * QUADS, 0, 0, 0, 0, count, 0));
    this.count = count;
  }

  /** Sort what is in `unsorted`. @param {GPUComputePassEncoder} encoder */
  encode(encoder) {
    const all = blocks(this.count);
    if (!all) return; // `sizes` says so already
    for (const [i, [count, add, scatter]] of this.passes.entries()) {
      encoder.setBindGroup(0, this.buffers.groups[i % 2]);
      for (const [pipeline, workgroups] of /** @type {[GPUComputePipeline, number][]} */ ([
        [count, all],
        [add, 1],
        [scatter, all],
      ])) {
        encoder.setPipeline(pipeline);
        encoder.dispatchWorkgroups(workgroups);
      }
    }
  }

  #free() {
    const { unsorted, sorted, places } = this.buffers;
    for (const buffer of [unsorted.keys, unsorted.numbers, sorted.keys, sorted.numbers, places]) buffer.destroy();
  }

  destroy() {
    this.#free();
    this.sizes.destroy();
  }
}
