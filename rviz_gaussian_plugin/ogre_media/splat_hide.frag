// The mean depth of what is in the target, where it is more opaque than not.

// 1 - depth, which stays exact where all is close to 1, times opacity; opacity
layout(binding = 1) uniform sampler2D nearness;
uniform ivec2 corner;  // of the viewport in the target [px]

void main() {
  vec2 blended = texelFetch(nearness, ivec2(gl_FragCoord.xy) - corner, 0).rg;
  if (blended.y < 0.5) discard;
  gl_FragDepth = 1.0 - blended.x / blended.y;
}
