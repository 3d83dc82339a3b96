// What a pass of the radix sort sorts by: 8 bits of the distance from the least key.
layout(std430) readonly buffer Least { uint least; };

uniform uint shift;

uint digitOf(uint key) { return key - least >> shift & 255u; }
