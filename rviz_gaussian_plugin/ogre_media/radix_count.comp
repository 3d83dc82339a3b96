// Counts how often each digit occurs, in all passes, among the keys that aren't kNone. Clears the passes' sums and the next
// sort's totals.

#pragma optionNV(unroll all)  // or NVIDIA's compiler keeps arrays in memory instead of registers

layout(local_size_x = 512) in;
layout(std430) readonly buffer Keys { uint keys[]; };
layout(std430) buffer Totals { uint totals[]; };
layout(std430) writeonly buffer NextTotals { uint next_totals[]; };  // the next sort's
layout(std430) writeonly buffer Sums { uint begun; uint sums[]; };   // as radix_scatter.comp has them

uniform uint passes;
uniform uint first_count;  // of the keys, with those of kNone; 0: there are none of these

const uint kLanes = 512u, kAtOnce = 8u;

shared uint histogram[256u * kMostPasses];

void main() {
  uint local = gl_LocalInvocationIndex, count = max(first_count, seen.count);
  uint all = kLanes * workGroups(), i = kLanes * workGroup() + local;
  if (i == 0u) begun = 0u;
  for (uint k = i; k < 256u * kMostPasses; k += all) next_totals[k] = 0u;
  for (uint k = i; k < 256u * ((count + kBlock - 1u) / kBlock); k += all) sums[k] = 0u;
  uint each = (count + all - 1u) / all * kLanes;
  uint begin = min(each * workGroup(), count), end = min(begin + each, count);
  if (begin == end) return;
  for (uint k = local; k < 256u * passes; k += kLanes) histogram[k] = 0u;
  barrier();
  for (uint first = begin + local; first < end; first += kLanes * kAtOnce) {
    uint key[kAtOnce];  // all are loaded before the first is used
    for (uint k = 0u; k < kAtOnce; ++k) key[k] = keys[min(first + kLanes * k, end - 1u)];
    for (uint k = 0u; k < kAtOnce; ++k) {
      if (first + kLanes * k >= end) break;
      if (key[k] == kNone) continue;
      for (uint pass = 0u; pass < passes; ++pass) {
        atomicAdd(histogram[256u * pass + digitOf(key[k], pass)], 1u);
      }
    }
  }
  barrier();
  for (uint k = local; k < 256u * passes; k += kLanes) {
    if (histogram[k] > 0u) atomicAdd(totals[k], histogram[k]);
  }
}
