// Finds where each tile's splats begin in the list, which is sorted by tile. They end where the next tile's
// begin. Cuts long lists of a tile into segments.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Tiles { uint tile_of[]; };
layout(std430) writeonly buffer Begins { uint begins[]; };
layout(std430) readonly buffer Length { Tally listed; };

const uint kEach = 255u;  // tiles of a work group: its last invocation finds where they end

shared uint begin_of[256];
shared uint later_count, cut_count, first_later, first_cut;

void main() {
  uint local = gl_LocalInvocationIndex, tile = kEach * workGroup() + local;
  uint low = 0u, high = listed.count;
  while (low < high) {
    uint middle = (low + high) / 2u;
    if (tile_of[middle] < tile) low = middle + 1u; else high = middle;
  }
  if (tile <= tileCount()) begins[tile] = low;
  begin_of[local] = low;
  if (local == 0u) {
    later_count = 0u;
    cut_count = 0u;
  }
  barrier();
  uint count = local < kEach && tile < tileCount() ? laterSegments(begin_of[local + 1u] - low) : 0u;
  uint cut, later;
  if (count > 0u) {
    cut = atomicAdd(cut_count, 1u);
    later = atomicAdd(later_count, count);
  }
  barrier();
  if (local == 0u && cut_count > 0u) {
    first_cut = atomicAdd(segments.cut_groups[0], cut_count);
    first_later = atomicAdd(segments.later_groups[0], later_count);
  }
  barrier();
  if (count == 0u) return;
  cut += first_cut;
  later += first_later;
  segments.words[cutOf(tile)] = cut;
  segments.words[tileOf(cut)] = tile;
  segments.words[laterOf(cut)] = later;
  for (uint n = 0u; n < count; ++n) segments.words[ownerOf(later + n)] = cut;
}
