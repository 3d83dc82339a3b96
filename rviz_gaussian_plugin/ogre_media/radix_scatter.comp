// One pass of a stable radix sort: keys and values go to where their digit's turn is. Lanes of 32
// find those with the same digit by ballots, one for each bit (Ashkiani et al. 2016). A block is
// put in order in shared memory first, so that what is next to each other is written together.

#pragma optionNV(unroll all)  // or NVIDIA's compiler keeps arrays in memory instead of registers

layout(local_size_x = 256) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) readonly buffer Values { uint values[]; };
layout(std430, binding = 2) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 3) writeonly buffer SortedValues { uint sorted_values[]; };
layout(std430, binding = 4) readonly buffer Firsts { uint firsts[]; };  // as radix_sum.comp says
layout(std430, binding = 5) readonly buffer Length { Tally keys_tally; };
layout(std430, binding = 6) readonly buffer Least { uint least; };  // key

uniform uint shift;
uniform bool first_pass;  // the values are 0, 1, 2...
uniform bool last_pass;   // nobody needs the keys any more

const uint kWarps = 8u, kEach = kBlock / 256u;

shared uint turns[kWarps][256];  // of each digit: within a warp's keys, then within the block
shared uint block_order[kBlock];
shared uint block_start[256];    // a digit's first place among all keys, less that in the block

// Warps are 32 lanes each; takeTurn() counts how many of a warp's keys so far, and of the lanes
// before, have this digit too.
#ifdef SUBGROUPS
// What a driver calls a subgroup's size is the most that it may be: it may run smaller ones.
bool haveWarps() { return gl_NumSubgroups == kWarps; }
uint warpOf(uint local) { return gl_SubgroupID; }
uint laneOf(uint local) { return gl_SubgroupInvocationID; }

uint takeTurn(uint warp, uint lane, uint digit, bool valid) {
  uint same = subgroupBallot(valid).x;
  for (uint bit = 0u; bit < 8u; ++bit) {
    bool set = (digit >> bit & 1u) != 0u;
    uint votes = subgroupBallot(set).x;
    same &= set ? votes : ~votes;
  }
  uint earlier = uint(bitCount(same & ((1u << lane) - 1u))), turn = 0u;
  if (valid && earlier == 0u) turn = atomicAdd(turns[warp][digit], uint(bitCount(same)));
  return subgroupShuffle(turn, uint(findLSB(same)) & 31u) + earlier;
}
#else
bool haveWarps() { return true; }
uint warpOf(uint local) { return local >> 5; }
uint laneOf(uint local) { return local & 31u; }

shared uint votes[kWarps][9];

uint takeTurn(uint warp, uint lane, uint digit, bool valid) {
  if (lane < 9u) votes[warp][lane] = 0u;
  barrier();
  if (valid) {
    atomicOr(votes[warp][8], 1u << lane);
    for (uint bit = 0u; bit < 8u; ++bit) {
      if ((digit >> bit & 1u) != 0u) atomicOr(votes[warp][bit], 1u << lane);
    }
  }
  barrier();
  uint same = votes[warp][8];
  for (uint bit = 0u; bit < 8u; ++bit) {
    same &= (digit >> bit & 1u) != 0u ? votes[warp][bit] : ~votes[warp][bit];
  }
  uint earlier = uint(bitCount(same & ((1u << lane) - 1u))), turn = turns[warp][digit] + earlier;
  barrier();
  if (valid && earlier == 0u) turns[warp][digit] += uint(bitCount(same));
  barrier();
  return turn;
}
#endif

uint digitOf(uint key) { return key - least >> shift & 255u; }

void main() {
  uint local = gl_LocalInvocationIndex, block = workGroup();
  uint warp = warpOf(local), lane = laneOf(local);
  uint count = keys_tally.count, blocks = (count + kBlock - 1u) / kBlock;
  if (block >= blocks || !haveWarps()) return;
  for (uint w = 0u; w < kWarps; ++w) turns[w][local] = 0u;
  barrier();

  uint first = block * kBlock + warp * kEach * 32u + lane;
  uint key[kEach], place[kEach];
  for (uint k = 0u; k < kEach; ++k) {
    uint i = first + 32u * k;
    bool valid = i < count;
    key[k] = valid ? keys[i] : 0u;
    place[k] = takeTurn(warp, lane, digitOf(key[k]), valid);
  }
  barrier();
  uint here = 0u, all;
  for (uint w = 0u; w < kWarps; ++w) here += turns[w][local];
  uint next = groupSum(here, all);
  block_start[local] = groupSum(firsts[256u * blocks + local], all) +
                       firsts[local * blocks + block] - next;
  for (uint w = 0u; w < kWarps; ++w) {
    uint mine = turns[w][local];
    turns[w][local] = next;
    next += mine;
  }
  barrier();

  uint size = min(count - block * kBlock, kBlock), target[kEach];
  for (uint k = 0u; k < kEach; ++k) {
    place[k] += turns[warp][digitOf(key[k])];
    if (first + 32u * k < count) block_order[place[k]] = key[k];
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) {
    uint i = 256u * k + local;
    if (i >= size) break;
    target[k] = block_start[digitOf(block_order[i])] + i;
    if (!last_pass) sorted_keys[target[k]] = block_order[i];
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) {
    uint i = first + 32u * k;
    if (i < count) block_order[place[k]] = first_pass ? i : values[i];
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) {
    uint i = 256u * k + local;
    if (i < size) sorted_values[target[k]] = block_order[i];
  }
}
