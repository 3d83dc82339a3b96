// Exclusive prefix sum of an array in place, in three passes over blocks of 2048 (Blelloch 1990).

layout(local_size_x = 256) in;
layout(std430, binding = 0) buffer Values { uint values[]; };
layout(std430, binding = 1) buffer Sums { uint sums[]; };    // of the blocks
layout(std430, binding = 2) writeonly buffer Total { uint total[]; };

uniform uint count;
uniform uint pass;  // 0: sums of blocks, 1: their prefix sums and the total, 2: that of each value
uniform uint total_index;

const uint kEach = 8u;  // values an invocation

shared uint partial[256];

// Exclusive prefix sum over the work group; `all` becomes the sum.
uint scan(uint value, out uint all) {
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

// Sums up the invocation's values of a block of `array`.
#define ADD_UP(array, size)                                                    \
  uint first = block * 256u * kEach + gl_LocalInvocationIndex * kEach;         \
  uint mine[kEach], sum = 0u, all;                                             \
  for (uint k = 0u; k < kEach; ++k) {                                          \
    mine[k] = first + k < (size) ? array[first + k] : 0u;                      \
    sum += mine[k];                                                            \
  }                                                                            \
  uint before = scan(sum, all);

void main() {
  if (pass == 1u) {
    uint blocks = (count + 256u * kEach - 1u) / (256u * kEach), carry = 0u;
    for (uint block = 0u; block * 256u * kEach < blocks; ++block) {
      ADD_UP(sums, blocks)
      before += carry;
      carry += all;
      for (uint k = 0u; k < kEach; ++k) {
        if (first + k < blocks) sums[first + k] = before;
        before += mine[k];
      }
    }
    if (gl_LocalInvocationIndex == 0u) total[total_index] = carry;
    return;
  }
  uint block = workGroup();
  if (block * 256u * kEach >= count) return;
  ADD_UP(values, count)
  if (pass == 0u) {
    if (gl_LocalInvocationIndex == 0u) sums[block] = all;
    return;
  }
  before += sums[block];
  for (uint k = 0u; k < kEach; ++k) {
    if (first + k < count) values[first + k] = before;
    before += mine[k];
  }
}
