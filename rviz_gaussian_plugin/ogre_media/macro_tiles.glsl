// The macro tiles of the region that a splat touches. It is listed with each of them.

const uint kListed = 32u;  // splats whose macro tiles are counted together, a group of splat_counts.glsl

// Rows of macro tiles, and what they have of the splat.
struct Touched {
  ivec2 rows;
  ivec2 columns;
  bool all;         // each row has these columns
  Outline outline;  // else what finds a row's
};

// index: of the splat; box: boxOf() it.
Touched touchedBy(uint index, uint box) {
  Touched t;
  ivec2 columns = boxColumns(box), rows = boxRows(box);
  t.columns = ivec2(columns.x / kMacro.x, (columns.y + kMacro.x - 1) / kMacro.x);
  t.rows = ivec2(rows.x / kMacro.y, (rows.y + kMacro.y - 1) / kMacro.y);
  // A splat touches all of one row or one column.
  t.all = box != kLargeBox && (t.columns.y - t.columns.x == 1 || t.rows.y - t.rows.x == 1);
  if (box == 0u) {
    t.all = true;
    t.rows = ivec2(0);
  }
  if (!t.all) {
    t.outline = outlineOf(ellipse(index));
    t.rows = rowsOf(t.outline, kTile * kMacro.y, macroTiles().y);
  }
  t.rows = clamp(t.rows, region.y, region.w);
  return t;
}

ivec2 columnsIn(Touched t, int row) {
  ivec2 columns = t.all ? t.columns : columnsOf(t.outline, row, kTile * kMacro, macroTiles().x);
  return clamp(columns, region.x, region.z);
}

uint countOf(Touched t) {
  uint count = 0u;
  for (int row = t.rows.x; row < t.rows.y; ++row) {
    ivec2 columns = columnsIn(t, row);
    count += uint(columns.y - columns.x);
  }
  return count;
}
