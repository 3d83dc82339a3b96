// The colour that a splat is blended in.
layout(std430) readonly buffer Seen { SeenTally seen; };

vec3 colourOf(Ellipse e) {
  if (e.kind != kByDepth) return e.colour;
  return depthColour(e.depth, vec2(keyDepth(seen.nearest_coloured), keyDepth(seen.farthest_coloured)));
}
