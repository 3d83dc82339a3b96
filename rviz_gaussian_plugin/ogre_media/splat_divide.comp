// Finds the splats that any tile may show before its translucent objects, or behind them: spares quads.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) writeonly buffer DrawnBefore { uint before[]; };  // or kNone
layout(std430) writeonly buffer DrawnBehind { uint behind[]; };  // or kNone
layout(std430) readonly buffer Length { Tally drawn_tally; };
layout(binding = 0) uniform sampler2D tile_depths;  // as in tile_depth.comp

const int kMostTiles = 32;    // a splat on more tiles counts as seen before and behind
const float kRounded = 2e-7;  // how far the rasterizer rounds a depth

void main() {
  uint i = invocation();
  if (i >= drawn_tally.count) return;
  uint index = drawn[i];
  bvec2 seen = bvec2(false);
  if (index != kNone) {
    Ellipse e = ellipse(index);
    float depth = windowDepth(e.depth);
    Outline outline = outlineOf(e);
    ivec2 rows = tileRows(outline);
    int looked = 0;
    for (int row = rows.x; row < rows.y && !all(seen); ++row) {
      ivec2 columns = tileColumns(outline, row);
      for (int column = columns.x; column < columns.y && !all(seen); ++column) {
        vec2 range = texelFetch(tile_depths, ivec2(column, row), 0).rg;
        seen = bvec2(seen.x || depth < range.y + kRounded, seen.y || depth > range.x - kRounded);
        if (++looked > kMostTiles) seen = bvec2(true);
      }
    }
  }
  before[i] = seen.x ? index : kNone;
  behind[i] = seen.y ? index : kNone;
}
