// The picture of opaque bodies, whose first row is the bottom, as the scene in which splats are drawn.

layout(binding = 0) uniform sampler2D colours;
layout(binding = 1) uniform sampler2D windows;  // 1: near; 0: far, or nothing
uniform vec2 clip;                              // near, far [m]
uniform vec2 ndc_depth;                         // as in splat_view.glsl
uniform bool orthographic;
layout(location = 0) out vec4 colour;
layout(location = 1) out float depth;  // [m]

void main() {
  ivec2 texel = ivec2(gl_FragCoord.xy);
  texel.y = textureSize(colours, 0).y - 1 - texel.y;
  colour = texelFetch(colours, texel, 0);
  float window = texelFetch(windows, texel, 0).r;
  depth = orthographic ? clip.y - window * (clip.y - clip.x)
                       : 1.0 / (window * ((clip.y - clip.x) / (clip.x * clip.y)) + 1.0 / clip.y);
  float ndc = (ndc_depth.x * depth + ndc_depth.y) / (orthographic ? 1.0 : depth);
  gl_FragDepth = window > 0.0 ? clamp(0.5 * ndc + 0.5, 0.0, 1.0) : 1.0;
  if (window <= 0.0) depth = uintBitsToFloat(0x7f800000u);  // infinity
}
