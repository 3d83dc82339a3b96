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

// Splats on more tiles than this are listed by 32 lanes, which find a row each, then list row by row.
const uint kLarge = 32u, kParts = 256u / 32u;
// The nearest splats are the largest. Of few splats, a work group takes 32 of each eighth of the order; or of each
// half, if splats touch more than kManyTiles tiles on average, so that more work groups share the large ones.
const uint kFewSplats = 524288u, kFewEach = 64u, kManyTiles = 8u;

shared uint large_count, most_rows;
shared uint large[256];
shared uint widths[kParts][32], tiles[kParts][32];  // of rows: how many tiles, and which is the first

uint firstOf(uint i) { return firsts[i / kListed] + within[i]; }

void listAlone(uint i) {
  uint splat = drawn[i], box = boxes[splat], next = firstOf(i);
  bool filled = fillsItsBox(box);
  Outline outline;
  if (!filled) outline = outlineOf(ellipse(splat));
  ivec2 rows = filled ? boxRows(box) : tileRows(outline);
  for (int row = rows.x; row < rows.y; ++row) {
    ivec2 columns = filled ? boxColumns(box) : tileColumns(outline, row);
    uint width = uint(columns.y - columns.x);
    for (uint k = 0u; k < width; ++k) {
      if (next + k >= listed.count) return;
      tile_of[next + k] = uint(row * view.tiles.x + columns.x) + k;
      splat_of[next + k] = splat;
    }
    next += width;
  }
}

// Lists large splats, one for each 32 lanes.
void listTogether(uint first, uint part, uint lane) {
  bool there = first + part < large_count;
  uint i = large[there ? first + part : first], splat = drawn[i], box = boxes[splat], next = firstOf(i);
  bool filled = fillsItsBox(box);
  Outline outline;
  if (!filled) outline = outlineOf(ellipse(splat));
  ivec2 rows = filled ? boxRows(box) : tileRows(outline);
  int height = there ? rows.y - rows.x : 0;
  if (lane == 0u) atomicMax(most_rows, uint(height));
  barrier();
  int most = int(most_rows);
  for (int from = 0; from < most; from += 32) {
    int row = rows.x + from + int(lane);
    ivec2 columns = ivec2(0);
    if (from + int(lane) < height) columns = filled ? boxColumns(box) : tileColumns(outline, row);
    widths[part][lane] = uint(columns.y - columns.x);
    tiles[part][lane] = uint(row * view.tiles.x + columns.x);
    barrier();
    for (int r = 0; r < min(height - from, 32); ++r) {
      uint width = widths[part][r], tile = tiles[part][r];
      for (uint k = lane; k < width && next + k < listed.count; k += 32u) {
        tile_of[next + k] = tile + k;
        splat_of[next + k] = splat;
      }
      next += width;
    }
    barrier();
  }
}

uint touchedBy(uint i) {
  if (i >= drawn_tally.count) return 0u;
  uint after = i + 1u, of = i / kListed;
  if (after % kListed > 0u && after < drawn_tally.count) return within[after] - within[i];
  return (after < drawn_tally.count ? firsts[of + 1u] : listed.wanted) - firsts[of] - within[i];
}

void main() {
  uint count = drawn_tally.count;
  bool few = count <= kFewSplats;
  uint each = few && listed.count > kManyTiles * count ? kFewEach : 256u, groups = (count + each - 1u) / each;
  if (workGroup() >= groups) return;
  if (gl_LocalInvocationIndex == 0u) large_count = 0u;
  barrier();
  uint lane = gl_LocalInvocationIndex % kListed, part = gl_LocalInvocationIndex / kListed;
  uint i = few ? kListed * (part * groups + workGroup()) + lane : invocation();
  uint touched = gl_LocalInvocationIndex < each ? touchedBy(i) : 0u;
  if (touched > kLarge) {
    large[atomicAdd(large_count, 1u)] = i;
  } else if (touched > 0u) {
    listAlone(i);
  }
  barrier();
  for (uint first = 0u; first < large_count; first += kParts) {
    if (gl_LocalInvocationIndex == 0u) most_rows = 0u;
    barrier();
    listTogether(first, part, lane);
  }
}
