// What a pass of the radix sort sorts by: 8 bits of the distance from the least key.
layout(std430) readonly buffer Seen { SeenTally seen; };

const uint kMostPasses = 4u;

uint digitOf(uint key, uint pass) { return key - seen.nearest >> 8u * pass & 255u; }
