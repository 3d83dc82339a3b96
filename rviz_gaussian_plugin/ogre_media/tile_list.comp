// Lists each drawn splat with each tile that it touches, in the order drawn.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) readonly buffer Within { uint within[]; };  // as tile_count.comp has them
layout(std430) readonly buffer Firsts { uint firsts[]; };    // prefix sum of the counts
layout(std430) readonly buffer Length { Tally drawn_tally; };
layout(std430) readonly buffer Listed { Tally listed; };
layout(std430) writeonly buffer Tiles { uint tile_of[]; };
layout(std430) writeonly buffer Splats { uint splat_of[]; };
layout(std430) readonly buffer Boxes { uint boxes[]; };

// Splats on more tiles than this are listed by 32 lanes.
const uint kLarge = 32u;
// The nearest splats are the largest: up to so many work groups, each takes 32 here and there.
const uint kFewGroups = 2048u;
shared uint large_count;
shared uint large[256];

void list(uint i, uint lane, uint lanes) {
  uint splat = drawn[i], box = boxes[splat], next = firsts[i / kListed] + within[i];
  bool filled = fillsItsBox(box);
  Outline outline;
  if (!filled) outline = outlineOf(ellipse(splat));
  ivec2 rows = filled ? boxRows(box) : tileRows(outline);
  for (int row = rows.x; row < rows.y; ++row) {
    ivec2 columns = filled ? boxColumns(box) : tileColumns(outline, row);
    uint width = uint(columns.y - columns.x);
    for (uint k = lane; k < width; k += lanes) {
      if (next + k >= listed.count) return;
      tile_of[next + k] = uint(row * view.tiles.x + columns.x) + k;
      splat_of[next + k] = splat;
    }
    next += width;
  }
}

uint touchedBy(uint i) {
  if (i >= drawn_tally.count) return 0u;
  uint after = i + 1u, of = i / kListed;
  if (after % kListed > 0u && after < drawn_tally.count) return within[after] - within[i];
  return (after < drawn_tally.count ? firsts[of + 1u] : listed.wanted) - firsts[of] - within[i];
}

void main() {
  uint groups = (drawn_tally.count + 255u) / 256u;
  if (workGroup() >= groups) return;
  if (gl_LocalInvocationIndex == 0u) large_count = 0u;
  barrier();
  uint lane = gl_LocalInvocationIndex % kListed, part = gl_LocalInvocationIndex / kListed;
  uint i = groups > kFewGroups ? invocation() : kListed * (part * groups + workGroup()) + lane;
  uint touched = touchedBy(i);
  if (touched > kLarge) {
    large[atomicAdd(large_count, 1u)] = i;
  } else if (touched > 0u) {
    list(i, 0u, 1u);
  }
  barrier();
  for (uint k = gl_LocalInvocationIndex / 32u; k < large_count; k += 8u) {
    list(large[k], gl_LocalInvocationIndex % 32u, 32u);
  }
}
