// The picture's tiles of 16x16 pixels, and which of them a splat touches.
const int kTile = 16;

uniform ivec2 tiles;  // in the picture, across and down

// The tiles of the rectangle around a splat's 1/255 ellipse: first, and one past the last.
ivec4 tileRectangle(Ellipse e) {
  vec2 minor = minorAxis(e);
  vec2 reach = cutoffSigmas(e.opacity) * sqrt(e.major * e.major + minor * minor);
  // Clamped as floats: integers end sooner.
  vec2 limit = vec2(tiles);
  vec2 low = clamp(floor((e.centre - reach) / float(kTile)), vec2(0.0), limit);
  vec2 high = clamp(floor((e.centre + reach) / float(kTile)) + 1.0, vec2(0.0), limit);
  return ivec4(low, max(low, high));
}
