// How many there are in groups, and in spans of these. The spans of this frame and those of the next, which are 0, take
// turns. So a work group finds how many there are before a group without a dispatch that sums up.
layout(std430) buffer Counts { uint counts[]; };

uniform uint spans;       // there is room for, in a frame
uniform uint first_span;  // of this frame: 0 or `spans`

const uint kSpan = 256u;  // groups

uint countAt(uint group) { return 2u * spans + group; }
uint spanAt(uint span) { return first_span + span; }

void keepCount(uint group, uint count) {
  counts[countAt(group)] = count;
  if (count > 0u) atomicAdd(counts[spanAt(group / kSpan)], count);
}

// The share of one of 32 lanes in the count of all groups before this one. A share ends at kMostShare, more than there is
// ever room for, so that no sum of shares turns over.
const uint kMostShare = 0x3ffffffu;
uint countBefore(uint group, uint lane) {
  uint span = group / kSpan, before = 0u;
  for (uint k = kSpan * span + lane; k < group; k += 32u) before += counts[countAt(k)];
  for (uint k = lane; k < span; k += 32u) before = min(before + counts[spanAt(k)], kMostShare);
  return before;
}

// Run by the 256 lanes of a work group.
void clearNextSpans() {
  for (uint k = gl_LocalInvocationIndex; k < spans; k += 256u) counts[spans - first_span + k] = 0u;
}
