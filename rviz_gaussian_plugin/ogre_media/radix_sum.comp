// A digit's counts -> where its keys begin among those with that digit, by block; behind all of
// them, how many keys there are with each digit. A work group a digit.

layout(local_size_x = 256) in;
layout(std430) buffer Counts { uint counts[]; };
layout(std430) readonly buffer Length { Tally keys_tally; };

void main() {
  uint blocks = (keys_tally.count + kBlock - 1u) / kBlock, digit = gl_WorkGroupID.x, sum = 0u;
  for (uint first = 0u; first < blocks; first += 256u) {
    uint block = first + gl_LocalInvocationIndex, i = digit * blocks + block, all;
    uint mine = block < blocks ? counts[i] : 0u;
    uint before = groupSum(mine, all);
    if (block < blocks) counts[i] = sum + before;
    sum += all;
  }
  if (gl_LocalInvocationIndex == 0u) counts[256u * blocks + digit] = sum;
}
