// Copies the words of some slots of an arena to one buffer, which the CPU reads in one go.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Wanted { uint wanted[]; };  // slots within their arenas
layout(std430) readonly buffer Held { uint held[]; };  // by the arena: slots, a band or a channel
layout(std430) writeonly buffer Gathered { uint gathered[]; };

uniform uint first, count;           // of the wanted slots, those in this arena
uniform uint words, offset, stride;  // a slot's words in `held`, and where they go in its `stride` words

void main() {
  uint i = invocation();
  if (i >= count * words) return;
  uint which = first + i / words, word = i % words;
  gathered[which * stride + offset + word] = held[wanted[which] * words + word];
}
