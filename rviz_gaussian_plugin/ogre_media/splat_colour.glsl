// The colour that a splat is blended in.
layout(std430) readonly buffer DepthRange {
  uint nearest, farthest;                    // keys of the depths of all splats
  uint nearest_coloured, farthest_coloured;  // keys of the depths of splats of kByDepth
};

vec3 colourOf(Ellipse e) {
  if (e.kind != kByDepth) return e.colour;
  return depthColour(e.depth, vec2(keyDepth(nearest_coloured), keyDepth(farthest_coloured)));
}
