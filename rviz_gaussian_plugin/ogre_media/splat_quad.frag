// A Gaussian's colour and alpha, premultiplied, to be blended back to front.

flat in vec4 colour;  // rgb, peakOf()
flat in vec2 centre;
flat in vec4 axes;
flat in float share;
layout(location = 0) out vec4 blended;
#ifdef BEHIND
layout(location = 1) out vec4 nearness;  // as in splat_hide.frag
layout(binding = 0) uniform sampler2D scene_depth;
#endif

void main() {
#ifdef BEHIND
  if (gl_FragCoord.z > texelFetch(scene_depth, ivec2(gl_FragCoord.xy), 0).r) discard;
#endif
  float falloff = falloffAt(axes, gl_FragCoord.xy - centre);
  float alpha = alphaAt(colour.a, falloff);
  if (alpha < kCutoffAlpha) discard;
  alpha = sharedAlpha(alpha, share);
  vec3 rgb = colour.rgb * (colour.a == kShadedPeak ? falloff : 1.0);
  blended = vec4(rgb * alpha, alpha);
#ifdef BEHIND
  nearness = vec4((1.0 - gl_FragCoord.z) * alpha, alpha, 0.0, alpha);
#endif
}
