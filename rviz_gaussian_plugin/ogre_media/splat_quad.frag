// A Gaussian's colour and alpha, premultiplied, to be blended back to front.

flat in vec4 colour;
in vec2 sigmas;
layout(location = 0) out vec4 blended;

uniform int mode;

void main() {
  float falloff = exp(-0.5 * dot(sigmas, sigmas));
  if (mode == kFlatBall || mode == kGaussianBall) {
    if (falloff < kBallEdge) discard;
    blended = vec4(colour.rgb * (mode == kGaussianBall ? falloff : 1.0), 1.0);
    return;
  }
  float alpha = min(kMaxAlpha, colour.a * falloff);
  if (alpha < kCutoffAlpha) discard;
  blended = vec4(colour.rgb * alpha, alpha);
}
