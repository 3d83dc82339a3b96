// One pass of a stable radix sort: moves keys and values to their digits' places. Lanes that run together, a
// warp, find the lanes with the same digit by ballots, one for each bit (Ashkiani et al. 2016). A warp is as
// wide as the driver has it, 8 to 64. A block is put in order in shared memory first, so that neighbours are
// written together. Blocks learn from earlier blocks where their keys begin (Adinets and Merrill 2022).

#pragma optionNV(unroll all)  // or NVIDIA's compiler keeps arrays in memory instead of registers

layout(local_size_x = LANES) in;
layout(std430) readonly buffer Keys { uint keys[]; };
layout(std430) readonly buffer Values { uint values[]; };
layout(std430) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430) writeonly buffer SortedValues { uint sorted_values[]; };
layout(std430) readonly buffer Totals { uint totals[]; };  // how many keys have a digit, of each pass
// Lets blocks ask earlier blocks for their sums (decoupled look-back: Merrill and Garland 2016).
layout(std430) coherent volatile buffer Sums { uint begun; uint sums[]; };  // begun: 0 between passes

uniform uint pass;
uniform bool are_places;   // the values are 0, 1, 2...
uniform uint first_count;  // of the keys, with those of kNone, which this pass leaves out; 0: there are none
uniform bool last_pass;    // the sorted keys aren't needed
// Where work groups can't wait for each other, a dispatch before the actual one only announces the sums.
uniform bool announcing;

const uint kLanes = uint(LANES), kEach = kBlock / kLanes;  // the first 256 have a digit each
const uint kMostWarps = 32u;
// Bits above a sum (at most kMostSum): the pass that announced it, from 1 on; whether it has all earlier blocks.
const uint kPass = 7u << 28, kAllBefore = 1u << 31;
// After these, sums are wrong, but nothing hangs. Mesa ends an invocation's loops after 65,535 turns in all.
const uint kMostWaits = 1u << 24;

shared uint memory[kBlock];    // the warps' turns, then the block in its order
shared uint turn;
shared uint block_start[256];  // a digit's first place among all keys, less its first place in the block

// How many of a warp's keys so far have a digit; later, where in the block the first of these goes. Two
// warps share a word.
uint turnsAt(uint warp, uint digit) { return 256u * (warp / 2u) + digit; }
uint turnsShift(uint warp) { return 16u * (warp & 1u); }
uint turns(uint warp, uint digit) {
  return memory[turnsAt(warp, digit)] >> turnsShift(warp) & 0xffffu;
}
uint takeTurns(uint warp, uint digit, uint count) {
  return atomicAdd(memory[turnsAt(warp, digit)], count << turnsShift(warp)) >> turnsShift(warp) & 0xffffu;
}

// A bit for each lane.
#if WARP > 32
#define Votes uvec2
uint countVotes(Votes votes) { return uint(bitCount(votes.x) + bitCount(votes.y)); }
uint firstVote(Votes votes) { return uint(votes.x != 0u ? findLSB(votes.x) : 32 + findLSB(votes.y)); }
Votes lanesBefore(uint lane) {
  uint bits = (1u << (lane & 31u)) - 1u;
  return lane < 32u ? uvec2(bits, 0u) : uvec2(kNone, bits);
}
#else
#define Votes uint
uint countVotes(Votes votes) { return uint(bitCount(votes)); }
uint firstVote(Votes votes) { return uint(findLSB(votes)); }
Votes lanesBefore(uint lane) { return (1u << lane) - 1u; }
#endif

// takeTurn() counts how many of a warp's keys so far, and of the lanes before, have this digit too.
#ifdef SUBGROUPS
// The subgroup size that a driver states is the largest: the driver may run smaller subgroups.
uint warpCount() { return gl_NumSubgroups; }
uint warpSize() { return gl_SubgroupSize; }
uint warpOf(uint local) { return gl_SubgroupID; }
uint laneOf(uint local) { return gl_SubgroupInvocationID; }

Votes ballot(bool vote) {
#if WARP > 32
  return subgroupBallot(vote).xy;
#else
  return subgroupBallot(vote).x;
#endif
}

uint takeTurn(uint warp, uint lane, uint digit, bool valid) {
  Votes same = ballot(valid);
  for (uint bit = 0u; bit < 8u; ++bit) {
    bool set = (digit >> bit & 1u) != 0u;
    Votes votes = ballot(set);
    same &= set ? votes : ~votes;
  }
  uint earlier = countVotes(same & lanesBefore(lane)), turn = 0u;
  if (valid && earlier == 0u) turn = takeTurns(warp, digit, countVotes(same));
  return subgroupShuffle(turn, firstVote(same) & (gl_SubgroupSize - 1u)) + earlier;
}
#else
const uint kWarp = uint(WARP), kWarps = kLanes / kWarp;
uint warpCount() { return kWarps; }
uint warpSize() { return kWarp; }
uint warpOf(uint local) { return local / kWarp; }
uint laneOf(uint local) { return local % kWarp; }

shared uint votes_of[kWarps][9][2];

void vote(uint warp, uint lane, uint bit) { atomicOr(votes_of[warp][bit][lane / 32u], 1u << lane % 32u); }

Votes votesFor(uint warp, uint bit) {
#if WARP > 32
  return uvec2(votes_of[warp][bit][0], votes_of[warp][bit][1]);
#else
  return votes_of[warp][bit][0];
#endif
}

uint takeTurn(uint warp, uint lane, uint digit, bool valid) {
  for (uint bit = lane; bit < 9u; bit += kWarp) votes_of[warp][bit] = uint[2](0u, 0u);
  barrier();
  if (valid) {
    vote(warp, lane, 8u);
    for (uint bit = 0u; bit < 8u; ++bit) {
      if ((digit >> bit & 1u) != 0u) vote(warp, lane, bit);
    }
  }
  barrier();
  Votes same = votesFor(warp, 8u);
  for (uint bit = 0u; bit < 8u; ++bit) {
    same &= (digit >> bit & 1u) != 0u ? votesFor(warp, bit) : ~votesFor(warp, bit);
  }
  uint earlier = countVotes(same & lanesBefore(lane)), turn = turns(warp, digit) + earlier;
  barrier();
  if (valid && earlier == 0u) takeTurns(warp, digit, countVotes(same));
  barrier();
  return turn;
}
#endif

// Returns the next block. All blocks before it have begun, so that a work group may wait for them.
uint takeBlock(uint blocks) {
  if (gl_LocalInvocationIndex == 0u) {
    turn = atomicAdd(begun, 1u);
    uint turns = workGroups() < blocks ? blocks + workGroups() : workGroups();
    if (turn + 1u == turns) begun = 0u;
  }
  barrier();
  return turn;
}

void announce(uint i, uint sum, bool all_before) {
  sums[i] = (all_before ? kAllBefore : 0u) | pass + 1u << 28 | sum;
}

bool isAnnounced(uint sum) { return (sum & kPass) == pass + 1u << 28; }

// How many keys of a digit are in the blocks before this one; asks several blocks at once.
uint keysBefore(uint block, uint digit) {
  uint sum = 0u;
  for (uint end = block, waited = 0u; end > 0u && waited < kMostWaits; ++waited) {
    uint those[4];
    for (uint k = 0u; k < 4u; ++k) those[k] = sums[256u * (max(end, k + 1u) - k - 1u) + digit];
    for (uint k = 0u; k < 4u && end > 0u && isAnnounced(those[k]); ++k) {
      sum += those[k] & kMostSum;
      end = (those[k] & kAllBefore) != 0u ? 0u : end - 1u;
    }
  }
  return sum;
}

void sortBlock(uint block, uint count) {
  uint local = gl_LocalInvocationIndex, warp = warpOf(local), lane = laneOf(local);
  uint pairs = (warpCount() + 1u) / 2u, stride = warpSize();
  for (uint k = local; k < 256u * pairs; k += kLanes) memory[k] = 0u;
  barrier();

  // All keys are loaded before the first is used.
  uint first = block * kBlock + warp * kEach * stride + lane;
  uint key[kEach], place[kEach];
  for (uint k = 0u; k < kEach; ++k) key[k] = keys[min(first + stride * k, count - 1u)];
  for (uint k = 0u; k < kEach; ++k) {
    if (first + stride * k >= count) key[k] = kNone;
    place[k] = takeTurn(warp, lane, digitOf(key[k], pass), key[k] != kNone);
  }
  barrier();
  bool counts_digit = local < 256u;
  uint here = 0u, all;
  if (counts_digit) {
    for (uint pair = 0u; pair < pairs; ++pair) {
      uint turns = memory[256u * pair + local];
      here += (turns & 0xffffu) + (turns >> 16);
    }
    announce(256u * block + local, here, block == 0u);
  }
  if (announcing) return;
  uint size, next = groupSum(here, size), in_block = next;
  uint start = groupSum(counts_digit ? totals[256u * pass + local] : 0u, all);
  if (counts_digit) {
    for (uint pair = 0u; pair < pairs; ++pair) {
      uint turns = memory[256u * pair + local], second = next + (turns & 0xffffu);
      memory[256u * pair + local] = next | second << 16;
      next = second + (turns >> 16);
    }
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) place[k] += turns(warp, digitOf(key[k], pass));
  barrier();

  uint value[kEach], target[kEach];
  for (uint k = 0u; k < kEach; ++k) {
    if (key[k] != kNone) memory[place[k]] = key[k];
  }
  for (uint k = 0u; k < kEach; ++k) {
    uint i = min(first + stride * k, count - 1u);
    value[k] = are_places ? i : values[i];
  }
  if (counts_digit) {
    uint before = keysBefore(block, local);
    if (block > 0u) announce(256u * block + local, before + here, true);
    block_start[local] = start + before - in_block;
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) {
    uint i = kLanes * k + local, sorted_key = memory[i];
    target[k] = block_start[digitOf(sorted_key, pass)] + i;
    if (!last_pass && i < size) sorted_keys[target[k]] = sorted_key;
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) {
    if (key[k] != kNone) memory[place[k]] = value[k];
  }
  barrier();
  for (uint k = 0u; k < kEach; ++k) {
    uint i = kLanes * k + local;
    if (i < size) sorted_values[target[k]] = memory[i];
  }
}

void main() {
  uint count = max(first_count, seen.count), blocks = (count + kBlock - 1u) / kBlock;
  if (warpCount() > kMostWarps) return;
  for (uint block = takeBlock(blocks); block < blocks; block = takeBlock(blocks)) {
    sortBlock(block, count);
    if (workGroups() >= blocks) break;
  }
}
