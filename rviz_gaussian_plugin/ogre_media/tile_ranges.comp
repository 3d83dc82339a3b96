// Where each tile's splats begin in the list, sorted by tile. They end where the next tile's begin.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Tiles { uint tile_of[]; };
layout(std430) writeonly buffer Begins { uint begins[]; };
layout(std430) readonly buffer Length { Tally listed; };

uniform uint tile_count;

void main() {
  uint tile = invocation();
  if (tile > tile_count) return;
  uint low = 0u, high = listed.count;
  while (low < high) {
    uint middle = (low + high) / 2u;
    if (tile_of[middle] < tile) low = middle + 1u; else high = middle;
  }
  begins[tile] = low;
}
