// Counts the macro tiles that drawn splats touch, each 32 splats in all, and puts the splats' boxes in the order
// drawn.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) readonly buffer Boxes { uint boxes[]; };
layout(std430) readonly buffer DrawnTally { Tally drawn_tally; };
layout(std430) writeonly buffer OrderedBoxes { uint ordered_boxes[]; };
layout(std430) writeonly buffer MacroPairs { Tally macro_pairs; };
layout(std430) writeonly buffer Wanted { uint wanted_splats, wanted_segments; };  // of tile_places.comp

const uint kParts = 256u / kListed;

shared uint pairs[kParts];

void main() {
  uint local = gl_LocalInvocationIndex, count = drawn_tally.count;
  if (workGroup() == 0u && local == 0u) {
    macro_pairs = Tally(0u, 0u);
    wanted_splats = 0u;
    wanted_segments = 0u;
    segments.count = 0u;
  }
  for (uint first = 256u * workGroup(); first < count; first += 256u * workGroups()) {
    if (local < kParts) pairs[local] = 0u;
    barrier();
    uint i = first + local;
    if (i < count) {
      uint index = drawn[i], box = index == kNone ? 0u : boxes[index];
      ordered_boxes[i] = box;
      atomicAdd(pairs[local / kListed], countOf(touchedBy(index, box)));
    }
    barrier();
    uint of = first / kListed + local;
    if (local < kParts && kListed * of < count) keepCount(of, pairs[local]);
  }
}
