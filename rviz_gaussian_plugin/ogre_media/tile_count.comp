// How many tiles each drawn splat touches.

layout(local_size_x = 256) in;
layout(std430, binding = 4) readonly buffer Drawn { uint drawn[]; };
layout(std430, binding = 5) writeonly buffer Counts { uint counts[]; };

uniform uint count;  // drawn

void main() {
  uint i = invocation();
  if (i >= count) return;
  uint touched = 0u;
  if (drawn[i] != kNone) {
    Ellipse e = ellipse(drawn[i]);
    if (e.opacity > 0.0) {
      ivec4 rectangle = tileRectangle(e);
      touched = uint((rectangle.z - rectangle.x) * (rectangle.w - rectangle.y));
    }
  }
  counts[i] = touched;
}
