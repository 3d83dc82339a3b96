// Lists each drawn splat with each tile that it touches, in the order drawn.

layout(local_size_x = 256) in;
layout(std430, binding = 4) readonly buffer Drawn { uint drawn[]; };
layout(std430, binding = 5) readonly buffer Firsts { uint firsts[]; };  // prefix sum of the counts
layout(std430, binding = 6) writeonly buffer Tiles { uint tile_of[]; };
layout(std430, binding = 7) writeonly buffer Splats { uint splat_of[]; };

uniform uint count;   // drawn
uniform uint listed;  // in all

// Splats on more tiles than this are listed by the whole work group.
const uint kLarge = 32u;
shared uint large_count;
shared uint large[256];

uint touched(uint i) { return (i + 1u < count ? firsts[i + 1u] : listed) - firsts[i]; }

void list(uint i, uint begin, uint step) {
  ivec4 rectangle = tileRectangle(ellipse(drawn[i]));
  int across = rectangle.z - rectangle.x;
  uint first = firsts[i], end = touched(i);
  for (uint k = begin; k < end; k += step) {
    ivec2 tile = rectangle.xy + ivec2(int(k) % across, int(k) / across);
    tile_of[first + k] = uint(tile.y * tiles.x + tile.x);
    splat_of[first + k] = drawn[i];
  }
}

void main() {
  if (gl_LocalInvocationIndex == 0u) large_count = 0u;
  barrier();
  uint i = invocation();
  if (i < count) {
    if (touched(i) > kLarge) {
      large[atomicAdd(large_count, 1u)] = i;
    } else if (touched(i) > 0u) {
      list(i, 0u, 1u);
    }
  }
  barrier();
  for (uint k = 0u; k < large_count; ++k) list(large[k], gl_LocalInvocationIndex, 256u);
}
