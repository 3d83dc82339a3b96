// Writes slots of an arena that lie apart.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Written { uint written[]; };  // of each its place in the arena, then its words
layout(std430) buffer Held { uint held[]; };  // by the arena: slots, a band, a channel or levels

uniform uint first, count, stride;  // of those written
uniform uint words, offset;  // held there of a slot, and where they are among those written
uniform bool in_bytes;  // a byte is

void main() {
  uint i = invocation();
  if (i >= count * words) return;
  uint slot = first + i / words * stride, word = i % words;
  uint place = written[slot], value = written[slot + offset + word];
  if (in_bytes) {  // of a word that has those of other slots
    uint shift = 8u * (place % 4u);
    atomicAnd(held[place / 4u], ~(0xffu << shift));
    atomicOr(held[place / 4u], value << shift);
  } else {
    held[place * words + word] = value;
  }
}
