// Exclusive prefix sum over a work group of 256; `all` becomes the sum. Sums end at kMostSum: none is
// ever taken for a small one, and min(a + b, kMostSum) gives the same in whatever order.

const uint kMostSum = 0x7fffffffu;
shared uint partial[256];

uint plus(uint a, uint b) { return min(a + b, kMostSum); }

uint groupSum(uint value, out uint all) {
  uint local = gl_LocalInvocationIndex;
  partial[local] = value;
  barrier();
  for (uint reach = 1u; reach < 256u; reach *= 2u) {
    uint left = local >= reach ? partial[local - reach] : 0u;
    barrier();
    partial[local] = plus(partial[local], left);
    barrier();
  }
  all = partial[255];
  uint before = local > 0u ? partial[local - 1u] : 0u;
  barrier();
  return before;
}
