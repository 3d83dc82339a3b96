// The picked splats for rviz's selection: a handle in 24 bits of colour.

layout(std430) readonly buffer Picked { uint picked[]; };  // as in splat_pick.comp
uniform ivec2 corner;  // of the viewport in the target [px]
uniform int width;     // of the picture [px]
uniform uint handle;   // of the map; 0: each slot is its own handle, counted from 1
layout(location = 0) out vec4 colour;

const uint kHandles = 1u << 24;

void main() {
  ivec2 texel = ivec2(gl_FragCoord.xy) - corner;
  uint slot = picked[texel.y * width + texel.x];
  if (slot >= kHandles - 1u) discard;
  uint shown = handle > 0u ? handle : slot + 1u;
  colour = vec4(uvec3(shown >> 16, shown >> 8, shown) & 255u, 255.0) / 255.0;
}
