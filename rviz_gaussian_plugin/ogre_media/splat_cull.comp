// Marks the slots of some pages that the picture may show: the sorters' test (rosplat_sorter/depth.py
// derives it), operation by operation, so that this shader and the sorters find the same slots.

layout(local_size_x = 256) in;

layout(std430) writeonly buffer Seen { SeenTally seen; };

shared uint words[8];

bool mayBeSeen(Page page, uint slot) {
  float opacity = opacityUnit(page) * slotOpacity(slot);
  if (!(opacity >= kCutoffAlpha) || !(map.opacity * opacity >= kCutoffAlpha)) return false;
  vec3 mean = slotPosition(slot);
  if (map.clip_to_box) {
    vec3 in_box = transformed(groups[page.group].to_box, mean);
    if (!all(lessThanEqual(abs(in_box), 0.5 * map.box_size))) return false;
  }
  vec3 scale = slotScale(slot);
  float extent = cutoffSigmas(opacity) * max(max(scale.x, scale.y), scale.z);
  vec3 p = transformed(groups[page.group].to_camera, mean);
  float w = view.orthographic ? 1.0 : p.z;
  precise vec2 reach = view.half_size * w + map.slope * extent;
  precise vec2 along = abs(view.focal * p.xy + view.offset * w);
  return p.z > view.clip.x && p.z < view.clip.y && all(lessThanEqual(along, reach)) &&
         shareOf(page, slot, mean) > 0.0;
}

void main() {
  Page page = groupPage();
  uint local = gl_LocalInvocationIndex, slot = kPageSlots * page.page + slotInPage();
  uint group = (kPageSlots * page.number + slotInPage()) / 256u;
  if (local < 8u) words[local] = 0u;
  barrier();
  if (mayBeSeen(page, slot)) atomicOr(words[local >> 5], 1u << (local & 31u));
  barrier();
  if (local < 8u) visible[8u * group + local].x = words[local];
  if (local > 0u) return;
  uint count = 0u;
  for (uint k = 0u; k < 8u; ++k) count += uint(bitCount(words[k]));
  keepCount(group, count);
  if (group == 0u) seen = SeenTally(Tally(0u, 0u), kNone, 0u, kNone, 0u);
}
