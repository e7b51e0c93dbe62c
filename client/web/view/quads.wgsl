// Quads in their order, many an instance: an instance of one would leave most of the hardware idle.

override QUADS: u32; // an instance

struct Quad { place: vec4f, minor: vec2f, colour: vec2u } // as in project.wgsl

struct Corner {
  @builtin(position) position: vec4f,
  @location(0) offset: vec2f, // in standard deviations
  @location(1) @interpolate(flat) colour: vec4f,
}

@group(0) @binding(0) var<storage, read> quads: array<Quad>;
@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> sizes: array<u32>; // Sizes of radix.wgsl

@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) instance: u32) -> Corner {
  let place = instance * QUADS + vertex / 4u;
  if (place >= sizes[6]) { // the last instance has quads to spare
    return Corner(vec4f(0.0, 0.0, 2.0, 1.0), vec2f(), vec4f());
  }
  let quad = quads[order[place]];
  let colour = vec4f(unpack2x16float(quad.colour.x), unpack2x16float(quad.colour.y));
  let side = vec2f(f32(vertex & 1u), f32((vertex >> 1u) & 1u)) * 2.0 - 1.0;
  let offset = side * sqrt(max(2.0 * log(255.0 * colour.w), 0.0)); // rounded, it may lie below 1/255
  return Corner(vec4f(quad.place.xy + offset.x * quad.place.zw + offset.y * quad.minor, 0.0, 1.0), offset, colour);
}

@fragment
fn shade(corner: Corner) -> @location(0) vec4f {
  let alpha = min(0.999, corner.colour.w * exp(-0.5 * dot(corner.offset, corner.offset)));
  if (alpha < 1.0 / 255.0) {
    discard;
  }
  return vec4f(corner.colour.rgb * alpha, alpha);
}
