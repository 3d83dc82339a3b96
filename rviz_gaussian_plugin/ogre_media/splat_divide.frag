// The depth of the nearest translucent object in a pixel's samples.

layout(binding = 0) uniform sampler2DMS translucent;
uniform int samples;  // of a pixel

void main() {
  float nearest = 1.0;
  for (int k = 0; k < samples; ++k) {
    nearest = min(nearest, texelFetch(translucent, ivec2(gl_FragCoord.xy), k).r);
  }
  gl_FragDepth = nearest;
}
