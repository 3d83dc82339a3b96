// The window depths of a picture that the processor has made.

uniform sampler2D depths;
varying vec2 place;  // in the picture, 0 to 1 over it

void main() { gl_FragDepth = texture2D(depths, place).r; }
