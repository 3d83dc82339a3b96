// The picture's tiles of 16x16 pixels, and which of them a splat touches.

#ifndef EXACTLY
#define EXACTLY
#endif

ivec2 tileAt(uint number) { return ivec2(int(number) % view.tiles.x, int(number) / view.tiles.x); }
// Splats whose tiles are counted together.
const uint kListed = 32u;

// 32 lanes blend a block of a tile's pixels, and skip the splats that don't reach it.
const ivec2 kPart = ivec2(8, 4);

// The pixel of an invocation of 256, in their tile.
ivec2 pixelInTile(uint local) {
  uint part = local / 32u;
  return ivec2(part % 2u, part / 2u) * kPart + ivec2(int(local) % kPart.x, int(local % 32u) / kPart.x);
}

#ifdef COMPUTE
ivec2 groupTile() { return tileAt(workGroup()); }  // where each tile has a work group
#endif

// A splat's 1/255 ellipse, as rows of the picture cut it.
struct Outline {
  vec2 centre, reach;  // centre and half size of the rectangle around it [px]
  float half_width;    // of the row through its centre [px]
  float lean;          // how far a row's middle moves right for each pixel down [px]
  float rightmost;     // how far below the centre its rightmost point is, and above it its leftmost [px]
};

Outline outlineOf(Ellipse e) {
  EXACTLY float sigmas = cutoffSigmas(e.opacity);
  EXACTLY vec2 minor = minorAxis(e);
  EXACTLY vec2 variance = e.major * e.major + minor * minor;
  EXACTLY float covariance = e.major.x * e.major.y + minor.x * minor.y;
  EXACTLY Outline o =
      Outline(e.centre, sigmas * sqrt(variance), sigmas * length(e.major) * e.minor / sqrt(variance.y),
              covariance / variance.y, sigmas * covariance / sqrt(variance.x));
  return o;
}

// The range of columns that the ellipse may cover in rows from `top` to `bottom` (centres of pixels). [px]
vec2 across(Outline o, float top, float bottom) {
  EXACTLY vec2 rows = clamp(vec2(top, bottom) - o.centre.y, -o.reach.y, o.reach.y);
  EXACTLY vec2 down = clamp(vec2(-o.rightmost, o.rightmost), rows.x, rows.y);
  EXACTLY vec2 half_width = o.half_width * sqrt(max(1.0 - down * down / (o.reach.y * o.reach.y), 0.0));
  EXACTLY vec2 ends = o.centre.x + o.lean * down + vec2(-half_width.x, half_width.y);
  return ends;
}

// Which of `cells` cells of a size hold centres of pixels in a range: the first, and one past the last.
ivec2 cellsIn(vec2 range, float size, int cells) {
  EXACTLY float slack = 0.05 + 1e-5 * (range.y - range.x);  // for rounding
  EXACTLY vec2 pixels = vec2(ceil(range.x - 0.5 - slack), floor(range.y - 0.5 + slack));
  if (!(pixels.x <= pixels.y)) return ivec2(0);
  // Clamped as floats, whose range is larger than that of integers.
  return ivec2(clamp(floor(pixels / size) + vec2(0.0, 1.0), 0.0, float(cells)));
}

ivec2 tileRows(Outline o) {
  EXACTLY vec2 range = o.centre.y + vec2(-o.reach.y, o.reach.y);
  return cellsIn(range, float(kTile), view.tiles.y);
}

ivec2 tileColumns(Outline o, int row) {
  float top = float(kTile * row) + 0.5;
  return cellsIn(across(o, top, top + float(kTile - 1)), float(kTile), view.tiles.x);
}

// The rectangle of tiles around a splat in a word: its first column, first row, width and height. 0 if no
// tile is in it; kLargeBox if a number has too many bits.
const uint kLargeBox = kNone;

uint boxOf(Outline o) {
  ivec2 rows = tileRows(o);
  ivec2 columns = cellsIn(o.centre.x + vec2(-o.reach.x, o.reach.x), float(kTile), view.tiles.x);
  ivec2 size = ivec2(columns.y - columns.x, rows.y - rows.x);
  if (size.x == 0 || size.y == 0) return 0u;
  if (any(greaterThan(ivec4(size, columns.x, rows.x), ivec4(62, 62, 1023, 1023)))) return kLargeBox;
  return uint(columns.x | rows.x << 10 | size.x << 20 | size.y << 26);
}

ivec2 boxColumns(uint box) { return int(box & 1023u) + ivec2(0, int(box >> 20 & 63u)); }

ivec2 boxRows(uint box) { return int(box >> 10 & 1023u) + ivec2(0, int(box >> 26)); }

// A splat touches all tiles of a box of one row or one column.
bool fillsItsBox(uint box) { return (box >> 20 & 63u) == 1u || box >> 26 == 1u; }
