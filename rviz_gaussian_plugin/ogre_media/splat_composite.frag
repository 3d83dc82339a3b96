// The blended splats over what is in the target.

layout(binding = 0) uniform sampler2D splats;
uniform ivec2 corner;  // of the viewport in the target [px]
layout(location = 0) out vec4 premultiplied;

void main() { premultiplied = texelFetch(splats, ivec2(gl_FragCoord.xy) - corner, 0); }
