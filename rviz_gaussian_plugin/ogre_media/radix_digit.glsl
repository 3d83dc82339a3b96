// What a pass of the radix sort sorts by: 8 bits of the distance from the least key, above the lowest ones.
layout(std430) readonly buffer Seen { SeenTally seen; };

uniform uint dropped;  // how many of the lowest bits the passes leave to radix_settle.comp

const uint kMostPasses = 4u;

uint digitOf(uint key, uint pass) { return key - seen.nearest >> dropped + 8u * pass & 255u; }
