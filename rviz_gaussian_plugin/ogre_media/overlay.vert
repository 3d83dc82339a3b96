// A corner of a cell, which comes in clip coordinates.

varying vec2 place;  // in the picture, 0 to 1 over it

void main() {
  gl_Position = gl_Vertex;
  place = gl_MultiTexCoord0.xy;
}
