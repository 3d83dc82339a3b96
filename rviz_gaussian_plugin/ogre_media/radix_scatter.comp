// One pass of a stable radix sort: keys and values go to where their digit's turn is. Lanes of 32
// find those with the same digit by ballots, one for each bit (Ashkiani et al. 2016).

layout(local_size_x = 256) in;
layout(std430, binding = 0) readonly buffer Keys { uint keys[]; };
layout(std430, binding = 1) readonly buffer Values { uint values[]; };
layout(std430, binding = 2) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(std430, binding = 3) writeonly buffer SortedValues { uint sorted_values[]; };
layout(std430, binding = 4) readonly buffer Firsts { uint firsts[]; };  // prefix sum of the counts

uniform uint count, blocks, shift;
uniform bool first_pass;  // the values are 0, 1, 2...

const uint kWarps = 8u;

shared uint turns[kWarps][256];  // of each digit within a warp's keys, then within the array

#ifdef SUBGROUPS
void agree() { subgroupMemoryBarrierShared(); subgroupBarrier(); }

uint peers(uint warp, uint lane, uint digit, bool valid) {
  uint same = subgroupBallot(valid).x;
  for (uint bit = 0u; bit < 8u; ++bit) {
    bool set = (digit >> bit & 1u) != 0u;
    uint votes = subgroupBallot(set).x;
    same &= set ? votes : ~votes;
  }
  return same;
}
#else
shared uint votes[kWarps][9];

void agree() { barrier(); }

uint peers(uint warp, uint lane, uint digit, bool valid) {
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
  return same;
}
#endif

void main() {
  uint local = gl_LocalInvocationIndex, lane = local & 31u, warp = local >> 5, block = workGroup();
  if (block >= blocks) return;
  for (uint w = 0u; w < kWarps; ++w) turns[w][local] = 0u;
  barrier();

  uint first = block * kKeysEach * 256u + warp * kKeysEach * 32u + lane;
  uint key[kKeysEach], turn[kKeysEach];
  for (uint k = 0u; k < kKeysEach; ++k) {
    uint i = first + 32u * k;
    bool valid = i < count;
    key[k] = valid ? keys[i] : 0u;
    uint digit = key[k] >> shift & 255u;
    uint same = peers(warp, lane, digit, valid);
    uint earlier = uint(bitCount(same & ((1u << lane) - 1u)));
    turn[k] = turns[warp][digit] + earlier;
    agree();
    if (valid && earlier == 0u) turns[warp][digit] += uint(bitCount(same));
    agree();
  }
  barrier();
  uint next = firsts[local * blocks + block];
  for (uint w = 0u; w < kWarps; ++w) {
    uint here = turns[w][local];
    turns[w][local] = next;
    next += here;
  }
  barrier();
  for (uint k = 0u; k < kKeysEach; ++k) {
    uint i = first + 32u * k;
    if (i >= count) return;
    uint target = turns[warp][key[k] >> shift & 255u] + turn[k];
    sorted_keys[target] = key[k];
    sorted_values[target] = first_pass ? i : values[i];
  }
}
