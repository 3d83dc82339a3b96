// A corner that is where it shall be.

varying vec2 place;  // in the picture

void main() {
  gl_Position = gl_Vertex;
  place = gl_MultiTexCoord0.xy;
}
