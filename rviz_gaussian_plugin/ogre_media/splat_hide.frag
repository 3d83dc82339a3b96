// The mean depth of the target's splats, where they are more opaque than not.

// Red: (1 - depth) * opacity, since 1 - depth stays exact where depths are close to 1. Green: opacity.
layout(binding = 1) uniform sampler2D nearness;
uniform ivec2 corner;  // of the viewport in the target [px]

void main() {
  vec2 blended = texelFetch(nearness, ivec2(gl_FragCoord.xy) - corner, 0).rg;
  if (blended.y < 0.5) discard;
  gl_FragDepth = 1.0 - blended.x / blended.y;
}
