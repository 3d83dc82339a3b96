// Exclusive prefix sum over a work group of 256; `all` becomes the sum.

shared uint partial[256];

uint groupSum(uint value, out uint all) {
  uint local = gl_LocalInvocationIndex;
  partial[local] = value;
  barrier();
  for (uint reach = 1u; reach < 256u; reach *= 2u) {
    uint left = local >= reach ? partial[local - reach] : 0u;
    barrier();
    partial[local] += left;
    barrier();
  }
  all = partial[255];
  uint before = partial[local] - value;
  barrier();
  return before;
}
