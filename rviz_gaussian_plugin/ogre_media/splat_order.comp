// Slots in a sorter's order, farthest first -> numbers of the splats in view, nearest first.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Order { uint order[]; };
layout(std430) writeonly buffer Drawn { uint drawn[]; };
layout(std430) readonly buffer Numbers { uint numbers[]; };  // of pages, or kNone
layout(std430) readonly buffer Keys { uint keys[]; };        // as splat_project.comp has them

uniform uint count;     // of the order
uniform uint capacity;  // slots of the map as it is uploaded; an order may know more

void main() {
  uint i = invocation();
  if (i >= count) return;
  uint slot = order[i], page = slot < capacity ? numbers[slot / kPageSlots] : kNone, splat = kNone;
  if (page != kNone) splat = kPageSlots * page + slot % kPageSlots;
  drawn[count - 1u - i] = splat != kNone && keys[splat] != kNone ? splat : kNone;
}
