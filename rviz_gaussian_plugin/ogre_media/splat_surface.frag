// The visible surface for rviz's mouse tools: mean depth over the far plane, in 24 bits of colour.

layout(binding = 0) uniform sampler2D depths;  // depth * alpha in red
uniform ivec2 corner;                          // of the viewport in the target [px]
uniform float far_clip;                        // [m]
layout(location = 0) out vec4 packed_depth;

void main() {
  vec4 blended = texelFetch(depths, ivec2(gl_FragCoord.xy) - corner, 0);
  if (blended.a < 0.5) discard;  // more void than surface
  uint depth = uint(16777215.0 * clamp(blended.r / blended.a / far_clip, 0.0, 1.0) + 0.5);
  // As rviz unpacks it: the lowest byte in blue.
  packed_depth = vec4(uvec3(depth >> 16, depth >> 8, depth) & 255u, 255.0) / 255.0;
}
