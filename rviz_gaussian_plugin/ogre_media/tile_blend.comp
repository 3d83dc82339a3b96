// Blends a tile's splats front to back, a pixel an invocation, until nothing behind can be seen.

layout(local_size_x = 16, local_size_y = 16) in;
layout(std430, binding = 4) readonly buffer Splats { uint splat_of[]; };
layout(std430, binding = 5) readonly buffer Ranges { uint ranges[]; };
layout(std430, binding = 6) readonly buffer DepthRange { uint nearest, farthest; };
layout(binding = 0) uniform sampler2D scene_depth;
layout(binding = 0) writeonly uniform image2D blended;

uniform ivec2 picture;     // [px]
uniform bool top_first;    // the target's first row is the picture's top
uniform int mode;
uniform vec2 depth_range;  // of mode kDepth [m]; empty: that of what is drawn

const uint kBatch = 256u;
// What is still to come can't change a pixel by more than this, of a white splat.
const float kTransparent = 1e-5;

shared vec4 places[kBatch];   // centre [px], direction of the major axis over its length [1/px]
shared vec4 shapes[kBatch];   // the same of the minor axis, window depth, -
shared vec4 colours[kBatch];  // rgb, opacity
shared uint finished;

void main() {
  ivec2 tile = ivec2(int(workGroup()) % tiles.x, int(workGroup()) / tiles.x);
  if (tile.y >= tiles.y) return;
  uint local = gl_LocalInvocationIndex;
  ivec2 pixel = tile * kTile + ivec2(gl_LocalInvocationID.xy);
  ivec2 texel = ivec2(pixel.x, top_first ? pixel.y : picture.y - 1 - pixel.y);
  bool inside = all(lessThan(pixel, picture));
  bool done = !inside;
  float hidden_from = inside ? texelFetch(scene_depth, texel, 0).r : 0.0;
  vec2 range = depth_range.y > depth_range.x ? depth_range
                                             : uintBitsToFloat(uvec2(nearest, farthest));
  vec3 colour = vec3(0.0);
  float transmittance = 1.0;

  uint index = uint(tile.y * tiles.x + tile.x);
  uint begin = ranges[2u * index], end = ranges[2u * index + 1u];
  if (local == 0u) finished = 0u;
  barrier();
  if (done) atomicAdd(finished, 1u);
  for (uint first = begin; first < end; first += kBatch) {
    if (first + local < end) {
      Ellipse e = ellipse(splat_of[first + local]);
      vec2 major = e.major / dot(e.major, e.major);
      places[local] = vec4(e.centre, major);
      vec2 minor = normalize(vec2(-e.major.y, e.major.x)) / e.minor;
      shapes[local] = vec4(minor, windowDepth(e.depth), 0.0);
      colours[local] = vec4(mode == kDepth ? depthColour(e.depth, range) : e.colour, e.opacity);
    }
    barrier();
    uint size = min(kBatch, end - first);
    for (uint k = 0u; k < size && !done; ++k) {
      vec4 place = places[k], shape = shapes[k];
      vec2 offset = vec2(pixel) + 0.5 - place.xy;
      vec2 sigmas = vec2(dot(offset, place.zw), dot(offset, shape.xy));
      float falloff = exp(-0.5 * dot(sigmas, sigmas));
      vec4 splat = colours[k];
      float alpha = min(kMaxAlpha, splat.a * falloff);
      if (mode == kFlatBall || mode == kGaussianBall) {
        alpha = falloff < kBallEdge ? 0.0 : 1.0;
        if (mode == kGaussianBall) splat.rgb *= falloff;
      }
      if (alpha < kCutoffAlpha || shape.z > hidden_from || shape.z < 0.0) continue;
      colour += transmittance * alpha * splat.rgb;
      transmittance *= 1.0 - alpha;
      done = transmittance < kTransparent;
      if (done) atomicAdd(finished, 1u);
    }
    barrier();
    if (finished == kBatch) break;
    barrier();
  }
  if (inside) imageStore(blended, texel, vec4(colour, 1.0 - transmittance));
}
