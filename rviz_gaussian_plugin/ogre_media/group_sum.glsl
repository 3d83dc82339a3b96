// Exclusive prefix sum over the first 256 invocations of a work group; `all` becomes the sum of all. Sums end
// at kMostSum: a large one never looks like a small one, and min(a + b, kMostSum) is the same in any order.

const uint kMostSum = 0x0fffffffu;
shared uint partial[256];

uint plus(uint a, uint b) { return min(a + b, kMostSum); }

#ifdef SUBGROUPS
uint groupSum(uint value, out uint all) {
  uint lane = gl_SubgroupInvocationID, last = gl_SubgroupSize - 1u, sum = value, before = 0u;
  for (uint reach = 1u; reach <= last; reach *= 2u) {
    uint left = subgroupShuffle(sum, (lane - reach) & last);
    if (lane >= reach) sum = plus(sum, left);
  }
  if (lane == last && gl_LocalInvocationIndex < 256u) partial[gl_SubgroupID] = sum;
  barrier();
  all = 0u;
  for (uint k = 0u; k < 256u / gl_SubgroupSize; ++k) {
    if (k == gl_SubgroupID) before = all;
    all = plus(all, partial[k]);
  }
  barrier();
  return plus(before, sum - value);
}
#else
uint groupSum(uint value, out uint all) {
  uint local = gl_LocalInvocationIndex, sum = value;
  if (local < 256u) partial[local] = sum;
  barrier();
  for (uint reach = 1u; reach < 256u; reach *= 2u) {
    if (local >= reach && local < 256u) sum = plus(sum, partial[local - reach]);
    barrier();
    if (local < 256u) partial[local] = sum;
    barrier();
  }
  all = partial[255];
  uint before = local > 0u && local < 256u ? partial[local - 1u] : 0u;
  barrier();
  return before;
}
#endif
