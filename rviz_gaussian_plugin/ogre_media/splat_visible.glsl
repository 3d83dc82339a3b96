// Which slots of the kept pages may be seen, numbered as in page_table.hpp. x: a bit each, 32 a word; y: how many
// bits are set before. A visible slot's index is the number of bits set before its own.
layout(std430) buffer Visible { uvec2 visible[]; };

bool isVisible(uint number) { return (visible[number >> 5].x & (1u << (number & 31u))) != 0u; }

uint visibleIndex(uint number) {
  uvec2 word = visible[number >> 5];
  return word.y + uint(bitCount(word.x & ((1u << (number & 31u)) - 1u)));
}

// The number of the slot of an index. words: how many `visible` has.
uint visibleNumber(uint index, uint words) {
  uint low = 0u, high = words;  // the last word with no more than `index` bits before it
  while (high - low > 1u) {
    uint middle = (low + high) / 2u;
    if (visible[middle].y <= index) low = middle; else high = middle;
  }
  uint bits = visible[low].x;
  for (uint skip = index - visible[low].y; skip > 0u; --skip) bits &= bits - 1u;
  return 32u * low + uint(findLSB(bits));
}
