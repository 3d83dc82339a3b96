// The picture's tiles of 16x16 pixels, its macro tiles of 8x4 tiles, and which of them a splat touches.

#ifndef EXACTLY
#define EXACTLY
#endif

ivec2 tileAt(uint number) { return ivec2(int(number) % view.tiles.x, int(number) / view.tiles.x); }
uint tileNumber(ivec2 tile) { return uint(tile.y * view.tiles.x + tile.x); }

const ivec2 kMacro = ivec2(8, 4);  // tiles of a macro tile
ivec2 macroTiles() { return (view.tiles + kMacro - 1) / kMacro; }

// A tile's splats, nearest first, in the list of all tiles.
struct TileList {
  uint begin, end;
  uint first_segment;  // as tile_segments.glsl has it, kNone if the list isn't cut
};

// 32 lanes blend a block of a tile's pixels, and skip the splats that don't reach it.
const ivec2 kPart = ivec2(8, 4);

// The pixel of an invocation of 256, in their tile.
ivec2 pixelInTile(uint local) {
  uint part = local / 32u;
  return ivec2(part % 2u, part / 2u) * kPart + ivec2(int(local) % kPart.x, int(local % 32u) / kPart.x);
}

#ifdef COMPUTE
// What is listed of the picture: the first column and row of macro tiles, and one past the last.
uniform ivec4 region;

// The tile of a work group, where each tile of the region has one. Further work groups get none of the picture.
ivec2 groupTile() {
  ivec2 first = region.xy * kMacro, size = min(region.zw * kMacro, view.tiles) - first;
  int group = int(workGroup());
  return group < size.x * size.y ? first + ivec2(group % size.x, group / size.x) : view.tiles;
}
#endif

// A splat's 1/255 outline, an ellipse, as rows of the picture cut it.
struct Outline {
  vec2 centre, reach;  // centre and half size of the rectangle around it [px]
  float half_width;    // of the row through its centre [px]
  float lean;          // how far a row's middle moves right for each pixel down [px]
  float rightmost;     // how far below the centre its rightmost point is, and above it its leftmost [px]
#ifdef DISCS
  vec4 spot;  // left, top, right and bottom of a disc's spot; empty where there is none [px]
#endif
};

#ifdef RAYS
// Reaches more than any picture.
const float kEverywhere = 1e9;
#endif

#ifdef DISCS
// The middle of a disc's spot. [px]
vec2 spotOf(Ellipse e) {
  EXACTLY vec2 minor = minorAxis(e);
  EXACTLY vec2 slope = vec2(dot(e.major, e.tilt), dot(minor, e.tilt));
  EXACTLY float left = 1.0 - (dot(slope, slope) + e.nearness);
  EXACTLY vec2 pull = slope.x * e.major + slope.y * minor;
  EXACTLY vec2 middle = abs(left) > kLeastAhead ? e.centre + pull / left : e.centre;
  return middle;
}
#endif

Outline outlineOf(Ellipse e) {
  EXACTLY float sigmas = cutoffSigmas(e.opacity);
  EXACTLY vec2 minor = minorAxis(e);
  EXACTLY vec2 variance = e.major * e.major + minor * minor;
  EXACTLY float covariance = e.major.x * e.major.y + minor.x * minor.y;
#ifdef RAYS
  // At `sigmas`, and a little beyond for rounding.
  EXACTLY float cut = 1.00002 * sigmas * sigmas;
  EXACTLY vec2 slope = vec2(dot(e.major, e.tilt), dot(minor, e.tilt));
  EXACTLY float ahead = dot(slope, slope), w = 1.0 - cut * (ahead + e.nearness);
  EXACTLY vec2 pull = slope.x * e.major + slope.y * minor, centre = e.centre + cut / w * pull;
  variance = (variance + cut / w * pull * pull) / w;
  covariance = (covariance + cut / w * pull.x * pull.y) / w;
  EXACTLY float area = length(e.major) * e.minor * sqrt(1.0 + cut / w * ahead) / w;
  EXACTLY Outline o = Outline(centre, sigmas * sqrt(variance), sigmas * area / sqrt(variance.y),
                              covariance / variance.y, sigmas * covariance / sqrt(variance.x)
#ifdef DISCS
                              , vec4(kEverywhere, kEverywhere, -kEverywhere, -kEverywhere)
#endif
  );
  if (!(w >= kLeastAhead)) {
    o.centre = 0.5 * vec2(view.picture);
    o.reach = vec2(kEverywhere);
    o.half_width = kEverywhere;
    o.lean = o.rightmost = 0.0;
  }
#ifdef DISCS
  if (e.has_spot) {
    EXACTLY vec2 spot = spotOf(e);
    EXACTLY float reach = sigmas * inversesqrt(kSpot);
    o.spot = vec4(spot - reach, spot + reach);
  }
#endif
#else
  EXACTLY Outline o =
      Outline(e.centre, sigmas * sqrt(variance), sigmas * length(e.major) * e.minor / sqrt(variance.y),
              covariance / variance.y, sigmas * covariance / sqrt(variance.x));
#endif
  return o;
}

// The outline as seen from a corner [px].
Outline seenFrom(Outline o, vec2 corner) {
  o.centre -= corner;
#ifdef DISCS
  o.spot -= corner.xyxy;
#endif
  return o;
}

// The ranges of columns and of rows that an outline covers. [px]
vec2 columnRange(Outline o) {
  EXACTLY vec2 range = o.centre.x + vec2(-o.reach.x, o.reach.x);
#ifdef DISCS
  range = vec2(min(range.x, o.spot.x), max(range.y, o.spot.z));
#endif
  return range;
}

vec2 rowRange(Outline o) {
  EXACTLY vec2 range = o.centre.y + vec2(-o.reach.y, o.reach.y);
#ifdef DISCS
  range = vec2(min(range.x, o.spot.y), max(range.y, o.spot.w));
#endif
  return range;
}

// The range of columns that the outline may cover in rows from `top` to `bottom` (centres of pixels). [px]
vec2 across(Outline o, float top, float bottom) {
  EXACTLY vec2 rows = clamp(vec2(top, bottom) - o.centre.y, -o.reach.y, o.reach.y);
  EXACTLY vec2 down = clamp(vec2(-o.rightmost, o.rightmost), rows.x, rows.y);
  EXACTLY vec2 half_width = o.half_width * sqrt(max(1.0 - down * down / (o.reach.y * o.reach.y), 0.0));
  EXACTLY vec2 ends = o.centre.x + o.lean * down + vec2(-half_width.x, half_width.y);
#ifdef DISCS
  if (o.spot.y <= bottom && top <= o.spot.w) ends = vec2(min(ends.x, o.spot.x), max(ends.y, o.spot.z));
#endif
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

// Rows of cells of so many pixels that the outline touches, and columns that it touches in one of them.
ivec2 rowsOf(Outline o, int height, int rows) { return cellsIn(rowRange(o), float(height), rows); }

ivec2 columnsOf(Outline o, int row, ivec2 size, int columns) {
  float top = float(size.y * row) + 0.5;
  return cellsIn(across(o, top, top + float(size.y - 1)), float(size.x), columns);
}

ivec2 tileRows(Outline o) { return rowsOf(o, kTile, view.tiles.y); }
ivec2 tileColumns(Outline o, int row) { return columnsOf(o, row, ivec2(kTile), view.tiles.x); }

// The rectangle of tiles around a splat in a word: its first column, first row, width and height. 0 if no
// tile is in it; kLargeBox if a number has too many bits.
const uint kLargeBox = kNone;

uint boxOf(Outline o) {
  ivec2 rows = tileRows(o);
  ivec2 columns = cellsIn(columnRange(o), float(kTile), view.tiles.x);
  ivec2 size = ivec2(columns.y - columns.x, rows.y - rows.x);
  if (size.x == 0 || size.y == 0) return 0u;
  if (any(greaterThan(ivec4(size, columns.x, rows.x), ivec4(62, 62, 1023, 1023)))) return kLargeBox;
  return uint(columns.x | rows.x << 10 | size.x << 20 | size.y << 26);
}

ivec2 boxColumns(uint box) { return int(box & 1023u) + ivec2(0, int(box >> 20 & 63u)); }

ivec2 boxRows(uint box) { return int(box >> 10 & 1023u) + ivec2(0, int(box >> 26)); }

// What splats are listed with: a macro tile, and what of it is in the splat's box, as columns and rows of tiles.
// Lists are sorted by the lowest 16 bits, the number of the macro tile.
uint macroKey(uint box, ivec2 macro) {
  ivec2 first = kMacro * macro;
  ivec2 columns = clamp(boxColumns(box) - first.x, 0, kMacro.x), rows = clamp(boxRows(box) - first.y, 0, kMacro.y);
  // A splat touches all tiles of one row or one column.
  bool exact = (box >> 20 & 63u) == 1u || box >> 26 == 1u;
  return uint(macro.y * macroTiles().x + macro.x) | uint(columns.x) << 16 | uint(columns.y) << 20 |
         uint(rows.x) << 24 | uint(rows.y) << 27 | uint(exact) << 31;
}

uint keyMacro(uint key) { return key & 0xffffu; }
ivec2 keyColumns(uint key) { return ivec2(key >> 16 & 15u, key >> 20 & 15u); }
ivec2 keyRows(uint key) { return ivec2(key >> 24 & 7u, key >> 27 & 7u); }
bool keyIsExact(uint key) { return key >> 31 != 0u; }
