// Where each tile's splats begin and end in the list, sorted by tile.

layout(local_size_x = 256) in;
layout(std430, binding = 4) readonly buffer Tiles { uint tile_of[]; };
layout(std430, binding = 5) writeonly buffer Ranges { uint ranges[]; };  // begin, end

uniform uint listed;

void main() {
  uint i = invocation();
  if (i >= listed) return;
  uint tile = tile_of[i];
  if (i == 0u || tile_of[i - 1u] != tile) ranges[2u * tile] = i;
  if (i + 1u == listed || tile_of[i + 1u] != tile) ranges[2u * tile + 1u] = i + 1u;
}
