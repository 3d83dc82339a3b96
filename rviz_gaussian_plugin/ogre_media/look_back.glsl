// Work groups that ask those before them, within a dispatch, for their sums (decoupled look-back: Merrill
// and Garland 2016).

layout(std430) coherent volatile buffer Sums { uint begun; uint sums[]; };  // begun: 0 between dispatches

uniform uint run;  // 1 to 7, of those since `sums` was cleared
// Drivers where work groups can't wait for each other announce sums in a dispatch before.
uniform bool announcing;

// Above a sum, at most kMostSum: in which run it was announced; whether those of all groups before are in it.
const uint kRun = 7u << 28, kAllBefore = 1u << 31;
// Beyond these, sums are wrong, but nothing hangs. Mesa ends an invocation's loops after 65,535 turns in all.
const uint kMostWaits = 1u << 24;

shared uint turn;

// Numbers work groups as they begin: those before one are at work, so that it may wait for them.
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
