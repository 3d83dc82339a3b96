// A picture that the processor has made.

uniform sampler2D picture;
varying vec2 place;  // in the picture, 0 to 1 over it

void main() {
  gl_FragColor = texture2D(picture, place);
  if (gl_FragColor.a == 0.0) discard;
}
