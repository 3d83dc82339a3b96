#version 430
// A Gaussian's colour and alpha, premultiplied, to be blended back to front.

flat in vec4 colour;
in vec2 sigmas;
layout(location = 0) out vec4 blended;

const float kMaxAlpha = 0.99;  // as in Kerbl et al. 2023; nothing is ever fully opaque

void main() {
  float alpha = min(kMaxAlpha, colour.a * exp(-0.5 * dot(sigmas, sigmas)));
  if (alpha < 1.0 / 255.0) discard;
  blended = vec4(colour.rgb * alpha, alpha);
}
