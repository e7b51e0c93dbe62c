/**
 * The last picture seen from a little way off: its colours moved by their depth, for devices on which drawing the splats
 * takes longer than a hand waits. What the picture did not show is made of what is beside it.
 */

import { dot, row } from "../lib/vectors.js";
import { link } from "./renderer.js";

/** @typedef {import("./renderer.js").Renderer} Renderer */
/** @typedef {import("./surface.js").View} View */

const NEAREST = 3; // nearness from which a ray is followed: a third of the range
const STEP_PX = 4,
  MAX_STEPS = 24,
  HALVINGS = 4; // along a ray to the first surface, in the kept picture; then closer to it
const MAX_TURN = 0.35,
  MAX_MOVE = 0.35; // radians; shares of the range: farther from where the picture was made it shows too little
const DUTY = 4; // a new picture is drawn once as many times as long as it takes has passed

const VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4. - 1., 0, 1); // one triangle around everything
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D colours, depths; // depths: nearness weighted by opacity, and the opacity
uniform mat3 turn;          // from this camera to that of the picture
uniform vec3 shift;         // the same, for a nearness of 1
uniform int steps;
uniform vec2 viewport, focal, principal;       // here, pixels
uniform vec2 thenViewport, thenFocal, thenPrincipal;
out vec4 result;
vec2 texel(vec3 to) { // where the picture shows what lies in that direction from its camera
  vec2 pixel = (thenFocal * to.xy / max(to.z, 1e-4) + thenPrincipal) / thenViewport;
  return vec2(pixel.x, 1. - pixel.y);
}
float surface(vec3 to) { // how near, seen from here, what the picture shows in that direction is
  vec2 depth = texture(depths, texel(to)).xw;
  return depth.y > .02 ? depth.x / depth.y * to.z : 0.;
}
void main() {
  vec2 pixel = vec2(gl_FragCoord.x, viewport.y - gl_FragCoord.y);
  vec3 ray = turn * vec3((pixel - principal) / focal, 1);
  float far = 0., before = ${NEAREST}.;
  for (int i = 1; i <= steps; i++) { // from near to far, up to what is behind the first surface
    float at = ${NEAREST}. * float(steps - i) / float(steps);
    if (surface(ray + at * shift) >= at) {
      far = at;
      break;
    }
    before = at;
  }
  for (int i = 0; i < ${HALVINGS}; i++) {
    float middle = .5 * (far + before);
    if (surface(ray + middle * shift) >= middle) far = middle;
    else before = middle;
  }
  result = vec4(texture(colours, texel(ray + far * shift)).rgb, 1);
}`;

export class Warp {
  /** @param {Renderer} renderer @throws {Error} where the graphics card cannot keep depths */
  constructor(renderer) {
    const { gl } = renderer;
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float"))
      throw new Error("no float buffers");
    this.renderer = renderer;
    this.program = link(gl, VERTEX, FRAGMENT);
    this.framebuffer = gl.createFramebuffer();
    this.array = gl.createVertexArray();
    this.textures = [gl.createTexture(), gl.createTexture()];
    this.width = this.height = 0;
    /** @type {View | null} from where the picture was drawn */
    this.seen = null;
    this.madeAt = 0;
    this.costMs = 0; // of the picture
  }

  /** Draw all that there is from there, to keep it. @param {View} view @param {number} width @param {number} height */
  keep(view, width, height) {
    const { gl } = this.renderer;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
    if (width !== this.width || height !== this.height) {
      for (const [i, texture] of this.textures.entries()) {
        gl.activeTexture(gl.TEXTURE3 + i);
        gl.bindTexture(gl.TEXTURE_2D, texture);
        const [inside, type] = i ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
        gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, gl.RGBA, type, null);
        for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
          gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
        for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
          gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
      }
      gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
      [this.width, this.height] = [width, height];
    }
    this.renderer.draw(view, { framebuffer: this.framebuffer, x: 0, y: 0, width, height, isDeep: true });
    this.seen = view;
    this.madeAt = performance.now();
  }

  /**
   * Whether a new picture is due: there is none, or it is old or from elsewhere, and the last one took little time.
   * @param {View} view
   * @param {boolean} isOld
   */
  isDue(view, isOld) {
    const { seen } = this;
    if (!seen) return true;
    if (performance.now() - this.madeAt < DUTY * this.costMs) return false;
    const turned = Math.acos(Math.min(1, dot(row(view.rotation, 2), row(seen.rotation, 2))));
    return isOld || turned > MAX_TURN || Math.hypot(...relative(view, seen).shift) > MAX_MOVE;
  }

  /** The kept picture as it is seen from there. @param {View} view */
  draw(view) {
    const { gl } = this.renderer,
      { width, height } = gl.canvas,
      { program } = this,
      seen = /** @type {View} */ (this.seen);
    const at = (/** @type {string} */ name) => gl.getUniformLocation(program, name);
    const { turn, shift } = relative(view, seen);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    gl.scissor(0, 0, width, height);
    gl.disable(gl.BLEND);
    gl.useProgram(program);
    gl.bindVertexArray(this.array);
    gl.uniform1i(at("colours"), 3);
    gl.uniform1i(at("depths"), 4);
    gl.uniformMatrix3fv(at("turn"), true, turn);
    gl.uniform3fv(at("shift"), shift);
    gl.uniform1i(
      at("steps"),
      Math.min(MAX_STEPS, 1 + Math.ceil((NEAREST * Math.hypot(...shift) * seen.focal[1]) / STEP_PX)),
    );
    gl.uniform2f(at("viewport"), width, height);
    gl.uniform2f(at("focal"), ...view.focal);
    gl.uniform2f(at("principal"), ...view.principal);
    gl.uniform2f(at("thenViewport"), this.width, this.height);
    gl.uniform2f(at("thenFocal"), ...seen.focal);
    gl.uniform2f(at("thenPrincipal"), ...seen.principal);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  destroy() {
    const { gl } = this.renderer;
    for (const texture of this.textures) gl.deleteTexture(texture);
    gl.deleteFramebuffer(this.framebuffer);
    gl.deleteVertexArray(this.array);
    gl.deleteProgram(this.program);
  }
}

/**
 * From one camera's axes to another's: x of `from` is `turn` x + `shift` for things at the other's range.
 * @type {(from: View, to: View) => { turn: number[], shift: number[] }}
 */
function relative(from, to) {
  const turn = [0, 1, 2].flatMap((i) => [0, 1, 2].map((j) => dot(row(to.rotation, i), row(from.rotation, j))));
  const shift = [0, 1, 2].map((i) => (to.translation[i] - dot(row(turn, i), from.translation)) / (to.range ?? 1));
  return { turn, shift };
}
