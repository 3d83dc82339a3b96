// Counts the macro tiles that drawn splats touch, each 32 splats in all, and puts the splats' boxes in the order
// drawn.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) readonly buffer Boxes { uint boxes[]; };
layout(std430) writeonly buffer OrderedBoxes { uint ordered_boxes[]; };
layout(std430) writeonly buffer Counts { uint counts[]; };
layout(std430) readonly buffer Length { Tally drawn_tally; };

shared uint sums[256u / kListed];

void main() {
  uint i = invocation(), part = gl_LocalInvocationIndex / kListed;
  if (gl_LocalInvocationIndex < 256u / kListed) sums[gl_LocalInvocationIndex] = 0u;
  barrier();
  if (i < drawn_tally.count) {
    uint index = drawn[i], box = index == kNone ? 0u : boxes[index];
    ordered_boxes[i] = box;
    atomicAdd(sums[part], countOf(touchedBy(index, box)));
  }
  barrier();
  if (i % kListed == 0u && i < drawn_tally.count) counts[i / kListed] = sums[part];
}
