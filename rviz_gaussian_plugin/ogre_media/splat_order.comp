// Slots in a sorter's order, farthest first -> indices of the visible splats, nearest first.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Order { uint order[]; };
layout(std430) writeonly buffer Drawn { uint drawn[]; };
layout(std430) readonly buffer Numbers { uint numbers[]; };  // of pages, or kNone

uniform uint count;     // of the order
uniform uint room;      // for visible splats
uniform uint capacity;  // slots of the map as it is uploaded; an order may know more

void main() {
  uint i = invocation();
  if (i >= count) return;
  uint slot = order[i], page = slot < capacity ? numbers[slot / kPageSlots] : kNone, index = kNone;
  if (page != kNone) {
    uint number = kPageSlots * page + slot % kPageSlots;
    if (isVisible(number)) index = visibleIndex(number);
  }
  drawn[count - 1u - i] = index < room ? index : kNone;
}
