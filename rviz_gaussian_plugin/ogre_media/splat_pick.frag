// For rviz's selection, a number in 24 bits of colour wherever a splat is picked.

layout(std430) readonly buffer Picked { uint picked[]; };  // as in splat_pick.comp
uniform ivec2 corner;  // of the viewport in the target [px]
uniform int width;     // of the picture [px]
uniform uint number;
layout(location = 0) out vec4 colour;

void main() {
  ivec2 texel = ivec2(gl_FragCoord.xy) - corner;
  if (picked[texel.y * width + texel.x] == kNone) discard;
  colour = vec4(uvec3(number >> 16, number >> 8, number) & 255u, 255.0) / 255.0;
}
