// Which slots of the kept pages may be seen, numbered as in page_table.hpp: a bit each, 32 a word, and how
// many bits are set before each word. A visible slot's index is the number of bits set before its own.
layout(std430) buffer Visible { uint visible[]; };
layout(std430) buffer Before { uint before[]; };

bool isVisible(uint number) { return (visible[number >> 5] & (1u << (number & 31u))) != 0u; }

uint visibleIndex(uint number) {
  return before[number >> 5] + uint(bitCount(visible[number >> 5] & ((1u << (number & 31u)) - 1u)));
}

// The number of the slot of an index. words: how many `visible` has.
uint visibleNumber(uint index, uint words) {
  uint low = 0u, high = words;  // the last word with no more than `index` bits before it
  while (high - low > 1u) {
    uint middle = (low + high) / 2u;
    if (before[middle] <= index) low = middle; else high = middle;
  }
  uint bits = visible[low];
  for (uint skip = index - before[low]; skip > 0u; --skip) bits &= bits - 1u;
  return 32u * low + uint(findLSB(bits));
}
