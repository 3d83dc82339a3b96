// The window depths of such a picture.

uniform sampler2D depths;
varying vec2 place;  // in it

void main() { gl_FragDepth = texture2D(depths, place).r; }
