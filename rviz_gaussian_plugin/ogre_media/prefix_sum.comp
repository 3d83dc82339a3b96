// Exclusive prefix sum of an array in place, in two passes over blocks of it.

layout(local_size_x = 256) in;
layout(std430) buffer Values { uint values[]; };
layout(std430) buffer Sums { uint sums[]; };  // of the blocks
layout(std430) readonly buffer Length { Tally values_tally; };
layout(std430) writeonly buffer Total { Tally total; };

uniform uint pass;  // 0: sums of blocks, 1: that of each value, and the total
uniform uint room;  // for as many as the total says
uniform uint each;  // of what the tally counts, a value

const uint kEach = kBlock / 256u;  // values an invocation

void main() {
  uint count = (values_tally.count + each - 1u) / each, block = workGroup(), local = gl_LocalInvocationIndex, all;
  if (block > 0u && block * kBlock >= count) return;
  uint first = block * kBlock + local * kEach, mine[kEach], sum = 0u;
  for (uint k = 0u; k < kEach; ++k) {
    mine[k] = first + k < count ? values[first + k] : 0u;
    sum = plus(sum, mine[k]);
  }
  uint before = groupSum(sum, all);
  if (pass == 0u) {
    if (local == 0u) sums[block] = all;
    return;
  }
  uint earlier = 0u, before_block;
  for (uint k = local; k < block; k += 256u) earlier = plus(earlier, sums[k]);
  groupSum(earlier, before_block);
  before = plus(before, before_block);
  for (uint k = 0u; k < kEach; ++k) {
    if (first + k < count) values[first + k] = before;
    before = plus(before, mine[k]);
  }
  if (local == 0u && (block + 1u) * kBlock >= count) total = tallied(plus(before_block, all), room);
}
