// How many tiles each drawn splat touches.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) writeonly buffer Counts { uint counts[]; };
layout(std430) readonly buffer Length { Tally drawn_tally; };
layout(std430) readonly buffer Boxes { uint boxes[]; };

uint touched(uint splat) {
  uint box = boxes[splat];
  if (box == 0u) return 0u;
  if (fillsItsBox(box)) return (box >> 20 & 63u) * (box >> 26);
  Outline outline = outlineOf(ellipse(splat));
  ivec2 rows = tileRows(outline);
  uint count = 0u;
  for (int row = rows.x; row < rows.y; ++row) {
    ivec2 columns = tileColumns(outline, row);
    count += uint(columns.y - columns.x);
  }
  return count;
}

void main() {
  uint i = invocation();
  if (i < drawn_tally.count) counts[i] = drawn[i] == kNone ? 0u : touched(drawn[i]);
}
