#version 430
// Which splat a pixel shows: the one that contributes most to its colour, alpha times the
// transmittance of what lies before it. A workgroup walks the order front to back for a tile of
// pixels, a batch of splats at a time.

layout(local_size_x = 16, local_size_y = 16) in;

layout(std430, binding = 0) readonly buffer Order { uint order[]; };
// The projected buffer in as many parts as the driver's largest buffer asks for.
layout(std430, binding = 1) readonly buffer Projected { vec4 data[]; } projected[4];
layout(std430, binding = 5) readonly buffer Depths { float depths[]; };  // of the opaque scene
layout(std430, binding = 6) writeonly buffer Picked { uint picked[]; };  // slot, or kNothing

uniform uint count;       // of the order
uniform uint part_slots;  // slots in a part
uniform uint capacity;    // slots of the map as it is uploaded; an order may know more
uniform ivec2 picture;    // [px]
uniform bool top_first;   // the target's first row is the picture's top
uniform int mode;         // as in DrawMode

const int kFlatBall = 3, kGaussianBall = 4;
// As in splat_quad.frag.
const float kBallEdge = 0.22, kMaxAlpha = 0.99, kMinAlpha = 1.0 / 255.0;
const float kLeastContribution = 0.05;  // less than this nobody sees
const uint kNothing = 0xffffffffu;
const uint kBatch = 256u, kWords = kBatch / 32u;

// The splats of a batch that reach the tile, nearest first.
shared uint reaching[kWords];  // a bit for each of the batch
shared uint searching;         // pixels that a farther splat may still win
shared uint slots[kBatch];
shared vec4 centres[kBatch], axes[kBatch];
shared float opacities[kBatch];

vec4 fetch(uint part, uint i) {
  switch (part) {
    case 0u: return projected[0].data[i];
    case 1u: return projected[1].data[i];
    case 2u: return projected[2].data[i];
    default: return projected[3].data[i];
  }
}

float alphaAt(uint k, vec2 pixel) {
  vec2 d = pixel - centres[k].xy;
  vec2 major = axes[k].xy, minor = axes[k].zw;
  vec2 sigmas = vec2(dot(d, major) / dot(major, major), dot(d, minor) / dot(minor, minor));
  float falloff = exp(-0.5 * dot(sigmas, sigmas));
  if (mode == kFlatBall || mode == kGaussianBall) return falloff < kBallEdge ? 0.0 : 1.0;
  float alpha = min(kMaxAlpha, opacities[k] * falloff);
  return alpha < kMinAlpha ? 0.0 : alpha;
}

void main() {
  uint lane = gl_LocalInvocationIndex;
  ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
  bool inside = all(lessThan(texel, picture));
  vec2 pixel = vec2(texel) + 0.5;
  vec2 tile_low = vec2(gl_WorkGroupID.xy * gl_WorkGroupSize.xy);
  vec2 tile_high = tile_low + vec2(gl_WorkGroupSize.xy);
  if (!top_first) {
    pixel.y = picture.y - pixel.y;
    tile_low.y = picture.y - tile_high.y;
    tile_high.y = tile_low.y + gl_WorkGroupSize.y;
  }
  uint texel_index = uint(texel.y * picture.x + texel.x);
  float opaque = inside ? 2.0 * depths[texel_index] - 1.0 : 0.0;
  float transmittance = inside ? 1.0 : 0.0, most = kLeastContribution;
  uint winner = kNothing;

  for (uint taken = 0u; taken < count; taken += kBatch) {
    if (lane < kWords) reaching[lane] = 0u;
    if (lane == 0u) searching = 0u;
    barrier();
    if (transmittance > most) atomicAdd(searching, 1u);
    uint slot = kNothing;
    vec4 centre, axis;
    float opacity = 0.0;
    if (taken + lane < count) {
      slot = order[count - 1u - taken - lane];
      uint part = slot / part_slots, i = 3u * (slot % part_slots);
      opacity = slot < capacity ? fetch(part, i + 2u).a : 0.0;
      if (opacity > 0.0) {
        centre = fetch(part, i);
        axis = fetch(part, i + 1u);
        float sigmas = min(3.33, sqrt(2.0 * log(255.0 * opacity)));
        vec2 extent = sigmas * sqrt(axis.xy * axis.xy + axis.zw * axis.zw);
        if (any(lessThan(centre.xy + extent, tile_low)) ||
            any(greaterThan(centre.xy - extent, tile_high))) opacity = 0.0;
      }
    }
    if (opacity > 0.0) atomicOr(reaching[lane / 32u], 1u << (lane % 32u));
    barrier();
    if (searching == 0u) break;
    uint kept = 0u, before = 0u;
    for (uint word = 0u; word < kWords; ++word) {
      if (word == lane / 32u) before = kept + bitCount(reaching[word] & ((1u << (lane % 32u)) - 1u));
      kept += bitCount(reaching[word]);
    }
    if (opacity > 0.0) {
      slots[before] = slot;
      centres[before] = centre;
      axes[before] = axis;
      opacities[before] = opacity;
    }
    barrier();
    for (uint k = 0u; k < kept && transmittance > most; ++k) {
      if (centres[k].z > opaque || abs(centres[k].z) > 1.0) continue;
      float alpha = alphaAt(k, pixel);
      if (transmittance * alpha > most) {
        most = transmittance * alpha;
        winner = slots[k];
      }
      transmittance *= 1.0 - alpha;
    }
  }
  if (inside) picked[texel_index] = winner;
}
