// How many tiles each drawn splat touches.

layout(local_size_x = 256) in;
layout(std430, binding = 4) readonly buffer Drawn { uint drawn[]; };
layout(std430, binding = 5) writeonly buffer Counts { uint counts[]; };
layout(std430, binding = 6) readonly buffer Length { Tally drawn_tally; };

void main() {
  uint i = invocation();
  if (i >= drawn_tally.count) return;
  uint touched = 0u;
  if (drawn[i] != kNone) {
    Ellipse e = ellipse(drawn[i]);
    if (e.opacity > 0.0) {
      Outline outline = outlineOf(e);
      ivec2 rows = tileRows(outline);
      for (int row = rows.x; row < rows.y; ++row) {
        ivec2 columns = tileColumns(outline, row);
        touched += uint(columns.y - columns.x);
      }
    }
  }
  counts[i] = touched;
}
