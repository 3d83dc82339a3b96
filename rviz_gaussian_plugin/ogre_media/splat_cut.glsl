// What share of a slot is drawn where nodes stand for splats: as in cut.hpp, lattice.hpp, mixture.hpp.
layout(std430) readonly buffer Levels { uint levels[]; };  // at which slots enter, a byte each

// The width of a level's cells; kBoundless beyond the last level, or without one. [m]
float cellSize(uint level) {
  return level < uint(kLevels) ? uintBitsToFloat((uint(127 + kFinestOctave) + level) << 23) : kBoundless;
}

float opacityUnit(Page page) { return page.level == kNone ? 1.0 : kMostNodeOpacity; }

// How wide the cell around a position is in the picture, at its nearest point. [px]
float errorOf(uint group, vec3 mean, float cell) {
  if (view.orthographic) return map.cut_focal * cell;
  vec3 eye = groups[group].eye.xyz;
  vec3 least = floor(mean / cell) * cell;
  vec3 outside = max(max(least - eye, eye - (least + cell)), vec3(0.0));
  return map.cut_focal * cell / max(length(outside), 1e-6);
}

float rise(float error) {
  float t = clamp((error - map.rise.x) * map.rise.y, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

float shareOf(Page page, uint slot, vec3 mean) {
  if (!map.cut) return 1.0;
  if (page.level == kNone) {
    return rise(errorOf(page.group, mean, cellSize(levels[slot >> 2] >> 8u * (slot & 3u) & 255u)));
  }
  return rise(errorOf(page.group, mean, cellSize(page.level >> 8))) - rise(errorOf(page.group, mean, cellSize(page.level & 255u)));
}
