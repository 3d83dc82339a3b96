// A picture as the processor takes it: bytes of RGB, bytes that are 1 where splats are a surface, depths as floats.

layout(local_size_x = 256) in;
layout(std430) writeonly buffer Words { uint words[]; };  // three, one and four for each four pixels
layout(binding = 0) uniform sampler2D colours;
layout(binding = 1) uniform sampler2D farther;  // depths of what is opaque [m]
layout(binding = 2) uniform sampler2D splats;   // as tile_blend.comp blends median depths

void main() {
  ivec2 size = textureSize(colours, 0);
  uint pixels = uint(size.x * size.y), fours = (pixels + 3u) / 4u, four = invocation();
  if (four >= fours) return;
  uint rgb[3] = uint[3](0u, 0u, 0u), surfaces = 0u;
  for (uint k = 0u; k < 4u; ++k) {
    uint pixel = min(4u * four + k, pixels - 1u);
    ivec2 texel = ivec2(pixel % uint(size.x), pixel / uint(size.x));
    uvec3 bytes = uvec3(255.0 * texelFetch(colours, texel, 0).rgb + 0.5);
    for (uint c = 0u; c < 3u; ++c) {
      uint place = 3u * k + c;
      rgb[place / 4u] |= bytes[c] << 8u * (place % 4u);
    }
    vec4 splat = texelFetch(splats, texel, 0);
    bool surface = splat.a >= 0.5;
    surfaces |= uint(surface) << 8u * k;
    words[4u * fours + 4u * four + k] = floatBitsToUint(surface ? splat.r : texelFetch(farther, texel, 0).r);
  }
  for (uint c = 0u; c < 3u; ++c) words[3u * four + c] = rgb[c];
  words[3u * fours + four] = surfaces;
}
