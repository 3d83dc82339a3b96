// Exclusive prefix sum of an array in place.

layout(local_size_x = 256) in;
layout(std430) buffer Values { uint values[]; };
layout(std430) readonly buffer Length { Tally values_tally; };
layout(std430) writeonly buffer Total { Tally total; };

uniform uint room;  // the most that the total's count may be
uniform uint each;  // how many of the tally's count share a value

const uint kEach = kBlock / 256u;  // values an invocation

shared uint nearest;

// The sum of all blocks before this one, which has announced `sum`.
uint sumBefore(uint block, uint sum) {
  uint local = gl_LocalInvocationIndex, before = 0u, all;
  for (uint end = block; end > 0u; end -= min(end, 256u)) {
    uint found = local < end ? awaitSum(end - 1u - local) : 0u;
    if (local == 0u) nearest = 256u;
    barrier();
    if ((found & kAllBefore) != 0u) atomicMin(nearest, local);
    barrier();
    groupSum(local <= nearest ? found & kMostSum : 0u, all);
    before = plus(before, all);
    if (nearest < 256u) break;
  }
  if (local == 0u && block > 0u) announce(block, plus(before, sum), true);
  return before;
}

void main() {
  uint count = (values_tally.count + each - 1u) / each, local = gl_LocalInvocationIndex, all;
  uint block = takeGroup();
  if (block > 0u && block * kBlock >= count) return;
  uint first = block * kBlock + local * kEach, mine[kEach], sum = 0u;
  for (uint k = 0u; k < kEach; ++k) {
    mine[k] = first + k < count ? values[first + k] : 0u;
    sum = plus(sum, mine[k]);
  }
  uint in_block = groupSum(sum, all);
  if (local == 0u) announce(block, all, block == 0u);
  if (announcing) return;
  uint before_block = sumBefore(block, all), before = plus(before_block, in_block);
  for (uint k = 0u; k < kEach; ++k) {
    if (first + k < count) values[first + k] = before;
    before = plus(before, mine[k]);
  }
  if (local == 0u && (block + 1u) * kBlock >= count) total = tallied(plus(before_block, all), room);
}
