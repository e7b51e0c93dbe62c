/**
 * Sorted splats on a canvas with WebGL2: quads by drawElements, vertex number = 4 x place + corner. Which splat has a
 * place in the order, a texture says, so that a new order is one number a splat; the quads' own numbers never change.
 *
 * The rules are those of the other renderers (codec/FORMAT.md section 14).
 */

import { RECORD, ROW_SPLATS } from "../decode/expand.js";
import { NEUTRAL } from "./exposure.js";
import { MAX_BLUR, MAX_KEEP, MIN_KEEP, quadVertices, Surface } from "./surface.js";

/** @typedef {import("./surface.js").View} View */

const TEXELS = RECORD / 4; // RGBA texels a splat
const WIDTH = ROW_SPLATS * TEXELS;
const ORDER_WIDTH = 1024; // texels of the texture with the order
const MAX_FENCES = 3; // a headset's and a film's pictures are drawn without asking how many are on their way
const RUN = 16_384; // quads that one drawElements draws: their vertices are numbered by 16 bits

const VERTEX = `#version 300 es
precision highp usampler2D;
uniform usampler2D splats, before, order;
uniform int first;          // place in the order of the first quad
uniform float moved;        // share of the way from there
uniform mat3 rotation;      // world to camera
uniform vec3 translation;
uniform vec2 viewport, focal, principal; // pixels
uniform float share;        // of the splats that are drawn where it matters least to leave some out; 1: all
uniform float range;        // distance up to which splats count as near, and at which they are sharp
uniform float lens;         // radius of the lens, world units; 0: everything is sharp
uniform vec3 gain, lift;    // of the exposure: gain * colour + lift
uniform float spread;       // area that each splat has to cover, in areas of its own; 1 where no level is missing
out vec2 offset;            // in standard deviations
flat out vec4 colour;
flat out float nearness;    // inverse depth, times range
void main() {
  int place = first + (gl_VertexID >> 2);
  int splat = int(texelFetch(order, ivec2(place % ${ORDER_WIDTH}, place / ${ORDER_WIDTH}), 0).x);
  float rank = float((uint(splat) * 2654435769u) >> 8) / 16777216.;  // as rankOf
  gl_Position = vec4(0, 0, 2, 1);                      // outside: dropped
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2. - 1.;
  ivec2 at = ivec2((splat % ${ROW_SPLATS}) * ${TEXELS}, splat / ${ROW_SPLATS});
  vec4 mean = uintBitsToFloat(texelFetch(splats, at, 0));
  vec4 upper = uintBitsToFloat(texelFetch(splats, at + ivec2(1, 0), 0));
  uvec4 last = texelFetch(splats, at + ivec2(2, 0), 0);
  vec2 lower = uintBitsToFloat(last.xy);
  if (moved < 1.) {                                    // places and opacities, as core/scene/interpolate.py
    vec4 old = uintBitsToFloat(texelFetch(before, at, 0));
    mean = mix(old, mean, vec4(vec3(old.w > 0. ? moved : 1.), moved)); // what is new fades in where it is
  }
  vec3 c = rotation * mean.xyz + translation;
  if (c.z < .01 || mean.w < 1. / 255.) return;
  vec2 way = c.xy / c.z, aside = abs((focal * way + principal) / viewport - .5);
  float weight = clamp(1.4 - 2. * length(aside), .25, 1.) * clamp(range / c.z, .25, 1.);
  float keep = share < 1. ? clamp(${MAX_KEEP} * share * weight, ${MIN_KEEP}, 1.) : 1.;
  mat3 world = mat3(upper.x, upper.y, upper.z, upper.y, upper.w, lower.x, upper.z, lower.x, lower.y);
  mat3 camera = rotation * world * transpose(rotation);
  if (rank > keep || max(aside.x, aside.y) > 1. && length(way) > 1. || camera[2].z > .25 * c.z * c.z) return; // the last two: cannot be linearised
  vec2 slack = .15 * viewport / focal;
  vec2 slope = clamp(way, -principal / focal - slack, (viewport - principal) / focal + slack);
  vec3 jx = vec3(focal.x, 0, -focal.x * slope.x) / c.z, jy = vec3(0, focal.y, -focal.y * slope.y) / c.z;
  vec3 kx = camera * jx;
  float area = spread / keep;                          // what is left covers what is left out
  float xx = area * dot(jx, kx) + .1, xy = area * dot(jy, kx), yy = area * dot(jy, camera * jy) + .1;
  float opacity = mean.w;
  if (lens > 0.) {                                     // the same light on a larger disc
    vec2 disc = focal * min(lens * abs(1. / c.z - 1. / range), ${MAX_BLUR});
    float sharp = xx * yy - xy * xy;
    xx += disc.x * disc.x;
    yy += disc.y * disc.y;
    opacity = max(opacity * sqrt(sharp / (xx * yy - xy * xy)), min(opacity, 2. / 255.));
  }
  float middle = .5 * (xx + yy), radius = length(vec2(.5 * (xx - yy), xy));
  float major = middle + radius, minor = max(middle - radius, 1e-6);
  vec2 axis = abs(xy) < 1e-6 ? (xx >= yy ? vec2(1, 0) : vec2(0, 1)) : normalize(vec2(xy, major - xx));
  offset = corner * sqrt(2. * log(255. * opacity));     // alpha falls below 1/255 there
  vec2 pixel = focal * way + principal + offset.x * sqrt(major) * axis + offset.y * sqrt(minor) * vec2(-axis.y, axis.x);
  nearness = range / c.z;
  colour = vec4(gain * vec3(unpackUnorm2x16(last.z), unpackUnorm2x16(last.w).x) + lift, opacity);
  gl_Position = vec4(2. * pixel.x / viewport.x - 1., 1. - 2. * pixel.y / viewport.y, 0, 1);
}`;

/** Colours, and if `isDeep` also how near they are. @type {(isDeep: boolean) => string} */
const fragment = (isDeep) => `#version 300 es
precision highp float;
in vec2 offset; flat in vec4 colour; flat in float nearness;
layout(location = 0) out vec4 result;
${isDeep ? "layout(location = 1) out vec4 depth;" : ""}
void main() {
  float alpha = min(.999, colour.a * exp(-.5 * dot(offset, offset)));
  if (alpha < 1. / 255.) discard;
  result = vec4(colour.rgb * alpha, alpha);
  ${isDeep ? "depth = vec4(nearness * alpha, 0, 0, alpha);" : ""}
}`;

/**
 * 0 to 1: multiples of the golden ratio, so that of any range of splats, and so at any place, a share has ranks below
 * it.
 * @type {(splat: number) => number}
 */
const rankOf = (splat) => (Math.imul(splat, 0x9e3779b9) >>> 8) / 0x1000000;

/** A program of two shaders. @type {(gl: WebGL2RenderingContext, vertex: string, fragment: string) => WebGLProgram} */
export function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of /** @type {[number, string][]} */ ([
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    gl.deleteShader(shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`the shaders do not link: ${gl.getProgramInfoLog(program)}`);
  }
  return program;
}

/**
 * A part of a framebuffer, pixels; `isDeep`: its second colour is how near things are, weighted by their opacity, and
 * that.
 * @typedef {{ framebuffer: WebGLFramebuffer | null, x: number, y: number, width: number, height: number, isSeeThrough?: boolean, isDeep?: boolean }} Target
 */

export class Renderer extends Surface {
  /**
   * @param {HTMLCanvasElement} canvas
   * @throws {Error} where WebGL2 is missing
   */
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", {
      antialias: false,
      alpha: false,
      depth: false,
      powerPreference: "high-performance",
    });
    if (!gl) throw new Error("no WebGL2");
    super(canvas);
    this.api = "WebGL2";
    this.gl = gl;
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    this.hardware = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER) ?? "");
    this.program = link(gl, VERTEX, fragment(false));
    /** @type {WebGLProgram | null} made when it is first asked for */
    this.deep = null;
    this.quads = gl.createBuffer();
    this.array = gl.createVertexArray();
    this.texture = gl.createTexture();
    this.before = gl.createTexture(); // of the state before
    this.places = gl.createTexture(); // the order
    this.placeRows = 0;
    this.source = gl.createFramebuffer(); // to copy from
    /** @type {Uint32Array} */
    this.order = new Uint32Array(0);
    this.uploaded = 1; // share of it that the graphics card has
    this.count = 0;
    /** @type {WebGLSync[]} one for each picture that is not drawn yet, as far as is known */
    this.fences = [];
    for (const [i, texture] of [this.before, this.places, this.texture].entries()) {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
        gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.source);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.quads);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, quadVertices(RUN), gl.STATIC_DRAW);
    gl.enable(gl.SCISSOR_TEST); // clearing one eye's part must not clear the other's
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Whether the browser took the graphics card away. */
  get isLost() {
    return this.gl.isContextLost();
  }

  /** @returns {number} of pictures that are still being drawn */
  get waiting() {
    const { gl, fences } = this;
    while (fences.length && gl.getSyncParameter(fences[0], gl.SYNC_STATUS) !== gl.UNSIGNALED)
      gl.deleteSync(/** @type {WebGLSync} */ (fences.shift()));
    return fences.length;
  }

  /** @type {Surface["update"]} */
  update(rows, spans, overMs = null) {
    const { gl } = this;
    if (overMs !== null) this.begin(overMs);
    if (overMs && this.rows) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.source);
      gl.activeTexture(gl.TEXTURE0);
      gl.copyTexImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, 0, 0, WIDTH, this.rows, 0);
    }
    gl.activeTexture(gl.TEXTURE2);
    if (rows > this.rows) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, WIDTH, rows, 0, gl.RGBA_INTEGER, gl.UNSIGNED_INT, null);
      this.rows = rows;
      this.movesFor = 0; // there is nothing to move on from
    }
    for (const { first, data } of spans) {
      const height = data.length / (4 * WIDTH);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, first, WIDTH, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, data);
    }
  }

  /** @param {Uint32Array} order */
  setOrder(order) {
    this.order = order;
    this.uploaded = -1;
  }

  /** Give the graphics card the order, without splats that are never drawn. @param {number} share */
  #upload(share) {
    const { gl } = this,
      limit = MAX_KEEP * share,
      order = limit < 1 ? this.order.filter((splat) => rankOf(splat) <= limit) : this.order;
    const rows = Math.ceil(order.length / ORDER_WIDTH),
      whole = Math.trunc(order.length / ORDER_WIDTH);
    gl.activeTexture(gl.TEXTURE1);
    if (rows > this.placeRows) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32UI, ORDER_WIDTH, rows, 0, gl.RED_INTEGER, gl.UNSIGNED_INT, null);
      this.placeRows = rows;
    }
    if (whole) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ORDER_WIDTH, whole, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    const rest = order.subarray(whole * ORDER_WIDTH);
    if (rest.length)
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, whole, rest.length, 1, gl.RED_INTEGER, gl.UNSIGNED_INT, rest);
    this.count = order.length;
    this.uploaded = share;
  }

  /** @param {View} view @param {Target} [target] - the canvas where none is given */
  draw(view, target) {
    const { gl } = this,
      { framebuffer, x, y, width, height } = target ?? {
        framebuffer: null,
        x: 0,
        y: 0,
        width: gl.canvas.width,
        height: gl.canvas.height,
      };
    const exposure = view.exposure ?? NEUTRAL;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, width, height);
    gl.scissor(x, y, width, height);
    gl.enable(gl.BLEND);
    gl.clearBufferfv(gl.COLOR, 0, target?.isSeeThrough ? [0, 0, 0, 0] : [...this.behind(view), 1]);
    if (target?.isDeep) gl.clearBufferfv(gl.COLOR, 1, [0, 0, 0, 0]);
    if (this.uploaded !== (view.share ?? 1)) this.#upload(view.share ?? 1);
    this.advance();
    if (!this.count) return;
    const program = target?.isDeep ? (this.deep ??= link(gl, VERTEX, fragment(true))) : this.program;
    const at = (/** @type {string} */ name) => gl.getUniformLocation(program, name);
    gl.useProgram(program);
    gl.bindVertexArray(this.array);
    gl.uniformMatrix3fv(at("rotation"), true, Float32Array.from(view.rotation));
    gl.uniform3fv(at("translation"), Float32Array.from(view.translation));
    gl.uniform2f(at("viewport"), width, height);
    gl.uniform2f(at("focal"), ...view.focal);
    gl.uniform2f(at("principal"), ...view.principal);
    gl.uniform1f(at("share"), view.share ?? 1);
    gl.uniform1f(at("range"), view.range ?? 1);
    gl.uniform1f(at("lens"), view.lens ?? 0);
    gl.uniform3fv(at("gain"), exposure.slice(0, 3));
    gl.uniform3fv(at("lift"), exposure.slice(3));
    gl.uniform1f(at("spread"), this.spread);
    for (const [i, name] of ["before", "order", "splats"].entries()) gl.uniform1i(at(name), i);
    gl.uniform1f(at("moved"), this.moved);
    const firstAt = at("first");
    for (let first = 0; first < this.count; first += RUN) {
      gl.uniform1i(firstAt, first);
      gl.drawElements(gl.TRIANGLES, 6 * Math.min(RUN, this.count - first), gl.UNSIGNED_SHORT, 0);
    }
    const fence = this.waiting < MAX_FENCES ? gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0) : null;
    if (fence) this.fences.push(fence);
  }

  destroy() {
    const { gl } = this;
    gl.deleteTexture(this.texture);
    gl.deleteTexture(this.before);
    gl.deleteTexture(this.places);
    gl.deleteFramebuffer(this.source);
    gl.deleteBuffer(this.quads);
    gl.deleteVertexArray(this.array);
    gl.deleteProgram(this.program);
    if (this.deep) gl.deleteProgram(this.deep);
  }
}
