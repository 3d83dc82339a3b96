// The depth of half as many pixels each way: of four, by turns the nearest and the farthest, so that
// both sides of an edge are there for splat_enlarge.frag (Jansen and Bavoil 2011).

layout(binding = 0) uniform sampler2D depths;
uniform int rows;        // of the target
uniform bool top_first;  // its first row is the picture's top

void main() {
  ivec2 size = textureSize(depths, 0);
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  if (!top_first) pixel.y = rows - 1 - pixel.y;
  float nearest = 1.0, farthest = 0.0;
  for (int k = 0; k < 4; ++k) {
    ivec2 texel = min(2 * pixel + ivec2(k & 1, k >> 1), size - 1);
    if (!top_first) texel.y = size.y - 1 - texel.y;
    float depth = texelFetch(depths, texel, 0).r;
    nearest = min(nearest, depth);
    farthest = max(farthest, depth);
  }
  gl_FragDepth = ((pixel.x + pixel.y) & 1) == 0 ? nearest : farthest;
}
