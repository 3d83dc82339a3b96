// One quad for each splat drawn, as large as its 1/255 ellipse, the farthest first.

layout(std430) readonly buffer Drawn { uint drawn[]; };  // nearest first
layout(std430) readonly buffer Length { Tally drawn_tally; };
layout(std430) readonly buffer Shares { float shares[]; };  // drawn share of each splat, if view.cut

uniform bool raw_depth;  // blend depths [m] instead of colours

// What a pixel needs to find its falloff itself: the driver rounds corners to a grid, and values that are
// interpolated between corners are as coarse.
flat out vec4 colour;  // rgb, peakOf()
flat out vec2 centre;  // in the target [px]
flat out vec4 axes;    // falloffAxes() in the target
flat out float share;

const float kGrid = 1.0 / 16.0;  // the coarsest grid of a driver [px]

void main() {
  uint index = drawn[drawn_tally.count - 1u - uint(gl_InstanceID)];
  Ellipse e;
  e.opacity = 0.0;
  if (index != kNone) e = ellipse(index);
  if (e.opacity <= 0.0) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    colour = axes = vec4(0.0);
    centre = vec2(0.0);
    share = 0.0;
    return;
  }
  colour = vec4(raw_depth ? vec3(e.depth) : colourOf(e), peakOf(e));
  share = view.cut ? shares[index] : 1.0;
  vec2 corner = vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID >> 1) * 2 - 1);
  vec2 sigmas = corner * (cutoffSigmas(e.opacity) + kGrid / vec2(length(e.major), e.minor));
  vec2 pixel = e.centre + sigmas.x * e.major + sigmas.y * minorAxis(e);
  vec2 ndc = 2.0 * pixel / vec2(view.picture) - 1.0;
  float down = view.top_first ? 1.0 : -1.0;
  gl_Position = vec4(ndc.x, down * ndc.y, ndcDepth(e.depth), 1.0);
  centre = vec2(e.centre.x, view.top_first ? e.centre.y : float(view.picture.y) - e.centre.y);
  axes = falloffAxes(e) * vec2(1.0, down).xyxy;
}
