#version 430
// A Gaussian's colour and alpha, premultiplied, to be blended back to front.

flat in vec4 colour;
in vec2 sigmas;
layout(location = 0) out vec4 blended;

uniform int mode;  // as in DrawMode
const int kFlatBall = 3, kGaussianBall = 4;
const float kBallEdge = 0.22;  // of the peak: a ball ends at 1.74 sigma

const float kMaxAlpha = 0.99;  // as in Kerbl et al. 2023; nothing is ever fully opaque

void main() {
  float falloff = exp(-0.5 * dot(sigmas, sigmas));
  if (mode == kFlatBall || mode == kGaussianBall) {
    if (falloff < kBallEdge) discard;
    blended = vec4(colour.rgb * (mode == kGaussianBall ? falloff : 1.0), 1.0);
    return;
  }
  float alpha = min(kMaxAlpha, colour.a * falloff);
  if (alpha < 1.0 / 255.0) discard;
  blended = vec4(colour.rgb * alpha, alpha);
}
