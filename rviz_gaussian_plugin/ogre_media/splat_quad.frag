#version 430
// A Gaussian's colour and alpha, premultiplied, to be blended back to front.

flat in vec4 colour;
in vec2 sigmas;
uniform float max_alpha;
layout(location = 0) out vec4 blended;

void main() {
  float alpha = min(max_alpha, colour.a * exp(-0.5 * dot(sigmas, sigmas)));
  if (alpha < 1.0 / 255.0) discard;
  blended = vec4(colour.rgb * alpha, alpha);
}
