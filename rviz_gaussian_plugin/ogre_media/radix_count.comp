// Counts how often each digit occurs, in all passes. Clears the passes' sums and the next sort's totals.

#pragma optionNV(unroll all)  // or NVIDIA's compiler keeps arrays in memory instead of registers

layout(local_size_x = 512) in;
layout(std430) readonly buffer Keys { uint keys[]; };
layout(std430) buffer Totals { uint totals[]; };
layout(std430) writeonly buffer NextTotals { uint next_totals[]; };  // the next sort's
layout(std430) writeonly buffer Sums { uint begun; uint sums[]; };   // as look_back.glsl has them
layout(std430) readonly buffer Length { Tally keys_tally; };

uniform uint passes;

const uint kLanes = 512u, kEach = kBlock / kLanes, kTotals = 256u * kMostPasses;

shared uint histogram[kTotals];

void main() {
  uint local = gl_LocalInvocationIndex, block = workGroup(), count = keys_tally.count;
  if (block == 0u) {
    if (local == 0u) begun = 0u;
    for (uint k = local; k < kTotals; k += kLanes) next_totals[k] = 0u;
  }
  if (block * kBlock >= count) return;
  if (local < 256u) sums[256u * block + local] = 0u;
  for (uint k = local; k < 256u * passes; k += kLanes) histogram[k] = 0u;
  barrier();
  uint first = block * kBlock + local, key[kEach];  // all are loaded before the first is used
  for (uint k = 0u; k < kEach; ++k) key[k] = keys[min(first + kLanes * k, count - 1u)];
  for (uint k = 0u; k < kEach; ++k) {
    if (first + kLanes * k >= count) break;
    for (uint pass = 0u; pass < passes; ++pass) {
      atomicAdd(histogram[256u * pass + digitOf(key[k], pass)], 1u);
    }
  }
  barrier();
  for (uint k = local; k < 256u * passes; k += kLanes) {
    if (histogram[k] > 0u) atomicAdd(totals[k], histogram[k]);
  }
}
