// Puts keys that are sorted but for their lowest bits in order, with their values. Keys that differ in these bits alone lie
// side by side, seldom more than a few, so each place looks among its neighbours for the key that belongs there.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Keys { uint keys[]; };
layout(std430) readonly buffer Values { uint values[]; };
layout(std430) writeonly buffer SortedValues { uint sorted_values[]; };
layout(std430) writeonly buffer Settled { SeenTally settled; };  // the same as `seen`

const uint kReach = 32u;  // keys on either side that a place looks at; where more are alike, settled.alike is set
const uint kBlockSettled = 1024u, kNear = kBlockSettled + 2u * kReach;

shared uint near[kNear];    // keys less the least one; kNone beyond the first and the last
shared uint sorted[kNear];  // what of these is sorted

// How many keys in a row, from a place on in steps of 1 or -1, are like its own in what is sorted.
uint alike(uint at, int step) {
  uint bits = sorted[at], count = 0u;
  while (count < kReach && sorted[uint(int(at) + step * int(count + 1u))] == bits) ++count;
  return count;
}

void settle(uint first, uint count, uint nearest) {
  uint local = gl_LocalInvocationIndex;
  for (uint k = local; k < kNear; k += 256u) {
    uint i = first + k;  // kReach further on
    near[k] = i >= kReach && i - kReach < count ? keys[i - kReach] - nearest : kNone;
    sorted[k] = near[k] >> dropped;
  }
  barrier();
  for (uint at = kReach + local; at < kReach + kBlockSettled; at += 256u) {
    uint i = first + at - kReach;
    if (i >= count) break;
    uint before = alike(at, -1), after = alike(at, 1), from = at - before, best = at;
    if (before + after >= kReach) settled.alike = 1u;
    // The key with `before` others of its run before it. Equal keys stay in order.
    for (uint k = from; before + after > 0u && k <= at + after; ++k) {
      uint rank = 0u;
      for (uint n = from; n <= at + after; ++n) rank += uint(near[n] < near[k] || (near[n] == near[k] && n < k));
      if (rank == before) best = k;
    }
    sorted_values[i] = values[first + best - kReach];
  }
  barrier();
}

void main() {
  uint count = seen.count, nearest = seen.nearest, all = kBlockSettled * workGroups();
  for (uint first = kBlockSettled * workGroup(); first < count; first += all) settle(first, count, nearest);
}
