// Lets the work groups of a dispatch ask earlier work groups for their sums (decoupled look-back: Merrill and
// Garland 2016).

layout(std430) coherent volatile buffer Sums { uint begun; uint sums[]; };  // begun: 0 between dispatches

uniform uint run;  // counts the runs since `sums` was cleared, 1 to 7
// Where work groups can't wait for each other, a dispatch before the actual one only announces the sums.
uniform bool announcing;

// Bits above a sum (at most kMostSum): the run that announced it; whether it includes all earlier groups.
const uint kRun = 7u << 28, kAllBefore = 1u << 31;
// After these, sums are wrong, but nothing hangs. Mesa ends an invocation's loops after 65,535 turns in all.
const uint kMostWaits = 1u << 24;

shared uint turn;

// Numbers work groups as they begin: all earlier ones have begun, so that a group may wait for them.
uint takeGroup() {
  if (gl_LocalInvocationIndex == 0u) {
    turn = atomicAdd(begun, 1u);
    if (turn + 1u == gl_NumWorkGroups.x * gl_NumWorkGroups.y) begun = 0u;
  }
  barrier();
  return turn;
}

void announce(uint i, uint sum, bool all_before) {
  sums[i] = (all_before ? kAllBefore : 0u) | run << 28 | sum;
}

bool isAnnounced(uint sum) { return (sum & kRun) == run << 28; }

uint awaitSum(uint i) {
  uint sum = sums[i];
  for (uint waited = 0u; !isAnnounced(sum) && waited < kMostWaits; ++waited) sum = sums[i];
  return sum;
}
