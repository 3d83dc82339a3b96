// Writes slots of an arena that lie apart.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Written { uint written[]; };  // of each its place in the arena, then its words
layout(std430) buffer Held { uint held[]; };  // by the arena: slots, a band, a channel or levels

uniform uint first, count, stride;  // in `written`: the first word, slots, words a slot
uniform uint words, offset;  // a slot's words in `held`, and where they are in its `stride` words
uniform bool in_bytes;  // `held` has a byte a slot

void main() {
  uint i = invocation();
  if (i >= count * words) return;
  uint slot = first + i / words * stride, word = i % words;
  uint place = written[slot], value = written[slot + offset + word];
  if (in_bytes) {  // the word has bytes of other slots, too
    uint shift = 8u * (place % 4u);
    atomicAnd(held[place / 4u], ~(0xffu << shift));
    atomicOr(held[place / 4u], value << shift);
  } else {
    held[place * words + word] = value;
  }
}
