// Marks the slots of one page that the picture may show: the sorters' test (rosplat_sorter/depth.py
// derives it), operation by operation, so that all of them find the same.

layout(local_size_x = 256) in;

uniform uint first_slot;  // of this page
uniform mat3 rotation;    // map -> camera: x right, y down, z forward
uniform vec3 translation;
uniform vec2 focal, offset, half_size, slope;
uniform vec2 clip;  // near, far [m]
uniform bool orthographic;
uniform float opacity_modifier, scale_modifier;
uniform float least_worth;  // of the alphas of all its pixels, added up
uniform bool clip_to_box;
uniform vec3 box_centre, box_size;  // [m]

shared uint words[8];

// What the alphas of a splat's pixels can add up to, whatever way it is turned: its ellipse is no
// larger than that of its two longer axes, seen flat on. What is worth less needs no sort.
float mostWorth(float opacity, vec3 scale, vec3 p, float w) {
  if (least_worth == 0.0) return 0.0;
  float longest = max(max(scale.x, scale.y), scale.z);
  float shortest = min(min(scale.x, scale.y), scale.z);
  float middle = scale.x + scale.y + scale.z - longest - shortest;
  vec2 across = vec2(longest, middle) * scale_modifier * max(focal.x, focal.y) / w;  // [px]
  float slant = orthographic ? 1.0 : dot(p, p) / (p.z * p.z);
  float area = across.x * across.x * across.y * across.y * slant;
  float spread = dot(across, across) * slant;
  return kTwoPi * opacity * sqrt(area + kLowPass * spread + kLowPass * kLowPass);
}

bool mayBeSeen(uint slot) {
  float opacity = slotOpacity(slot);
  if (!(opacity >= kCutoffAlpha) || !(opacity_modifier * opacity >= kCutoffAlpha)) return false;
  vec3 mean = slotPosition(slot);
  if (clip_to_box && any(greaterThan(abs(mean - box_centre), 0.5 * box_size))) return false;
  vec3 scale = slotScale(slot);
  float extent = cutoffSigmas(opacity) * max(max(scale.x, scale.y), scale.z);
  precise vec3 p = ((rotation[0] * mean.x + rotation[1] * mean.y) + rotation[2] * mean.z) + translation;
  float w = orthographic ? 1.0 : p.z;
  precise vec2 reach = half_size * w + slope * extent;
  precise vec2 along = abs(focal * p.xy + offset * w);
  return p.z > clip.x && p.z < clip.y && all(lessThanEqual(along, reach)) &&
         mostWorth(opacity_modifier * opacity, scale, p, w) >= least_worth;
}

void main() {
  uint local = gl_LocalInvocationIndex, slot = invocation();
  if (local < 8u) words[local] = 0u;
  barrier();
  if (slot < slot_count && mayBeSeen(slot)) atomicOr(words[local >> 5], 1u << (local & 31u));
  barrier();
  uint word = (first_slot >> 5) + 8u * workGroup() + local;
  if (local < 8u && word < uint(visible.length())) {
    visible[word] = words[local];
    before[word] = uint(bitCount(words[local]));
  }
}
