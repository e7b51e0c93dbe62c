// Splats as quads on the picture, one thread each: the vertex shader's part of renderer.js, once a splat, and its depth.

override MAX_KEEP: f32; // as in surface.js
override MIN_KEEP: f32;
override MAX_BLUR: f32;
const LEAST = 1.0 / 255.0; // opacity below which nothing is drawn
const NEAREST = 0x3c000000u; // bits of 1/128, which is less than the depth of any splat that is drawn
const MOST = 0xffffffu;      // keys have 24 bits
const LEFT_OUT = 0xffffffffu;

struct View {
  x: vec4f, y: vec4f, z: vec4f, // rows of the rotation from world to camera, with the translation
  viewport: vec2f, focal: vec2f, principal: vec2f, // pixels
  share: f32, range: f32,       // as in surface.js
  gain: vec3f, moved: f32,      // exposure: gain * colour + lift; share of the way from the state before
  lift: vec3f, spread: f32,
  near: f32, count: u32,        // splats in `shown`
  lens: f32,                    // its radius, world units; 0: everything is sharp, not only what is at `range`
}

struct Quad {
  place: vec4f, // of the middle, and from there one standard deviation along the longer axis; the picture is -1 to 1
  minor: vec2f, // along the shorter one
  colour: vec2u, // red, green, blue, opacity as 16-bit floats
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<vec4u>; // three each, as decode/expand.js has them
@group(0) @binding(2) var<storage, read> before: array<vec4u>; // the same, of the state before
@group(0) @binding(3) var<storage, read> shown: array<u32>;    // their numbers
@group(0) @binding(4) var<storage, read_write> keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> numbers: array<u32>;
@group(0) @binding(6) var<storage, read_write> quads: array<Quad>;

@compute @workgroup_size(256)
fn project(@builtin(global_invocation_id) thread: vec3u) {
  let i = thread.x;
  if (i >= view.count) {
    return;
  }
  keys[i] = LEFT_OUT;
  numbers[i] = i;
  let splat = shown[i];
  var mean = bitcast<vec4f>(splats[3u * splat]);
  if (view.moved < 1.0) { // places and opacities, as core/scene/interpolate.py
    let old = bitcast<vec4f>(before[3u * splat]);
    let way = select(1.0, view.moved, old.w > 0.0); // what is new fades in where it is
    mean = mix(old, mean, vec4f(way, way, way, view.moved));
  }
  let world = vec4f(mean.xyz, 1.0);
  let c = vec3f(dot(view.x, world), dot(view.y, world), dot(view.z, world));
  if (c.z < 0.01 || dot(c, c) < view.near * view.near || mean.w < LEAST) {
    return;
  }
  let way = c.xy / c.z;
  let aside = abs((view.focal * way + view.principal) / view.viewport - 0.5);
  let weight = clamp(1.4 - 2.0 * length(aside), 0.25, 1.0) * clamp(view.range / c.z, 0.25, 1.0);
  let keep = select(1.0, clamp(MAX_KEEP * view.share * weight, MIN_KEEP, 1.0), view.share < 1.0);
  let rank = f32((splat * 2654435769u) >> 8u) / 16777216.0; // as rankOf in renderer.js
  let upper = bitcast<vec4f>(splats[3u * splat + 1u]);
  let last = splats[3u * splat + 2u];
  let lower = bitcast<vec2f>(last.xy);
  let covariance = mat3x3f(upper.x, upper.y, upper.z, upper.y, upper.w, lower.x, upper.z, lower.x, lower.y);
  let depth = dot(view.z.xyz, covariance * view.z.xyz); // how far it reaches along the view
  if (rank > keep || (max(aside.x, aside.y) > 1.0 && length(way) > 1.0) || depth > 0.25 * c.z * c.z) {
    return; // the last two: cannot be linearised
  }
  let slack = 0.15 * view.viewport / view.focal;
  let slope = clamp(way, -view.principal / view.focal - slack, (view.viewport - view.principal) / view.focal + slack);
  let jx = view.focal.x / c.z * (view.x.xyz - slope.x * view.z.xyz); // pixels a unit of the world
  let jy = view.focal.y / c.z * (view.y.xyz - slope.y * view.z.xyz);
  let kx = covariance * jx;
  let area = view.spread / keep; // what is left covers what is left out
  var xx = area * dot(jx, kx) + 0.1;
  let xy = area * dot(jy, kx);
  var yy = area * dot(jy, covariance * jy) + 0.1;
  var opacity = mean.w;
  if (view.lens > 0.0) { // the same light on a larger disc
    let disc = view.focal * min(view.lens * abs(1.0 / c.z - 1.0 / view.range), MAX_BLUR);
    let sharp = xx * yy - xy * xy;
    xx += disc.x * disc.x;
    yy += disc.y * disc.y;
    opacity = max(opacity * sqrt(sharp / (xx * yy - xy * xy)), min(opacity, 2.0 * LEAST));
  }
  let middle = 0.5 * (xx + yy);
  let radius = length(vec2f(0.5 * (xx - yy), xy));
  let major = middle + radius;
  let minor = max(middle - radius, 1e-6);
  var axis = select(vec2f(0.0, 1.0), vec2f(1.0, 0.0), xx >= yy);
  if (abs(xy) >= 1e-6) {
    axis = normalize(vec2f(xy, major - xx));
  }
  let reach = sqrt(2.0 * log(255.0 * opacity)); // alpha falls below 1/255 there
  let scale = vec2f(2.0, -2.0) / view.viewport;
  let at = scale * (view.focal * way + view.principal) + vec2f(-1.0, 1.0);
  let long = sqrt(major) * scale * axis;
  let short = sqrt(minor) * scale * vec2f(-axis.y, axis.x);
  let extent = reach * (abs(long) + abs(short));
  if (any(abs(at) - extent > vec2f(1.0))) {
    return; // beside the picture
  }
  let colour = view.gain * vec3f(unpack2x16unorm(last.z), unpack2x16unorm(last.w).x) + view.lift;
  quads[i] = Quad(vec4f(at, long), short, vec2u(pack2x16float(colour.xy), pack2x16float(vec2f(colour.z, opacity))));
  keys[i] = MOST - min((bitcast<u32>(c.z) - NEAREST) >> 4u, MOST); // far ones first; bits of positive floats are ordered
}
