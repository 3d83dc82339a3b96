// Copies what some slots of an arena hold to where the CPU reads it at once.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Wanted { uint wanted[]; };  // slots within their arenas
layout(std430) readonly buffer Held { uint held[]; };  // by the arena: slots, or a band
layout(std430) writeonly buffer Gathered { uint gathered[]; };

uniform uint first, count;          // of those wanted in this arena
uniform uint words, offset, stride;  // held of a slot, and where they go among those gathered

void main() {
  uint i = invocation();
  if (i >= count * words) return;
  uint which = first + i / words, word = i % words;
  gathered[which * stride + offset + word] = held[wanted[which] * words + word];
}
