// Lists each drawn splat with each macro tile that it touches, in the order drawn.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) readonly buffer OrderedBoxes { uint ordered_boxes[]; };
layout(std430) readonly buffer DrawnTally { Tally drawn_tally; };
layout(std430) writeonly buffer MacroPairs { Tally macro_pairs; };
layout(std430) writeonly buffer Keys { uint keys[]; };  // macroKey()s
layout(std430) writeonly buffer Splats { uint splat_of[]; };

uniform uint room;  // for all pairs

// Splats on more macro tiles than this are listed by 32 lanes, which find a row each, then list row by row.
const uint kLarge = 32u, kParts = 256u / kListed;
// The nearest splats are the largest. Of few splats, a work group takes 32 of each eighth of the order.
const uint kFewSplats = 524288u;

shared uint sums[256];             // of a splat's pairs, and of those before it in its 32
shared uint pairs_before[kParts];  // of 32 splats, or of all 256 in the first
shared uint large_count, most_rows;
shared uint large[256], large_next[256];
shared int begins_of[kParts][32], ends_of[kParts][32];  // columns of rows

void write(uint to, uint splat, uint box, ivec2 macro) {
  if (to >= room) return;
  keys[to] = macroKey(box, macro);
  splat_of[to] = splat;
}

void listAlone(Touched touched, uint splat, uint box, uint next) {
  for (int row = touched.rows.x; row < touched.rows.y; ++row) {
    ivec2 columns = columnsIn(touched, row);
    for (int column = columns.x; column < columns.y; ++column) write(next++, splat, box, ivec2(column, row));
  }
}

// Lists large splats, one for each 32 lanes.
void listTogether(uint first, uint part, uint lane) {
  bool there = first + part < large_count;
  uint of = there ? first + part : first, i = large[of], splat = drawn[i], box = ordered_boxes[i];
  uint next = large_next[of];
  Touched touched = touchedBy(splat, box);
  int height = there ? touched.rows.y - touched.rows.x : 0;
  if (lane == 0u) atomicMax(most_rows, uint(height));
  barrier();
  int most = int(most_rows);
  for (int from = 0; from < most; from += 32) {
    ivec2 columns = ivec2(0);
    if (from + int(lane) < height) columns = columnsIn(touched, touched.rows.x + from + int(lane));
    begins_of[part][lane] = columns.x;
    ends_of[part][lane] = columns.y;
    barrier();
    for (int r = 0; r < min(height - from, 32); ++r) {
      ivec2 row = ivec2(begins_of[part][r], ends_of[part][r]);
      for (int column = row.x + int(lane); column < row.y; column += 32) {
        write(next + uint(column - row.x), splat, box, ivec2(column, touched.rows.x + from + r));
      }
      next += uint(row.y - row.x);
    }
    barrier();
  }
}

// Lists 256 splats, one of so many groups of these.
void list(uint group, uint groups, uint count) {
  uint local = gl_LocalInvocationIndex;
  if (local == 0u) large_count = 0u;
  if (local < kParts) pairs_before[local] = 0u;
  uint lane = local % kListed, part = local / kListed;
  bool scattered = count <= kFewSplats;
  uint i = scattered ? kListed * (part * groups + group) + lane : 256u * group + local;
  bool there = i < count;
  uint splat = there ? drawn[i] : kNone, box = there ? ordered_boxes[i] : 0u;
  Touched touched = touchedBy(splat, box);
  uint mine = countOf(touched), sum = mine;
  sums[local] = sum;
  barrier();
  if (scattered ? i - lane < count : part == 0u) atomicAdd(pairs_before[part], countBefore(i / kListed, lane));
  for (uint reach = 1u; reach < kListed; reach *= 2u) {
    if (lane >= reach) sum += sums[local - reach];
    barrier();
    sums[local] = sum;
    barrier();
  }
  uint next = pairs_before[scattered ? part : 0u] + sum - mine;
  for (uint k = 0u; k < part && !scattered; ++k) next += sums[kListed * k + kListed - 1u];
  if (i + 1u == count) macro_pairs = tallied(next + mine, room);
  if (mine > kLarge) {
    uint k = atomicAdd(large_count, 1u);
    large[k] = i;
    large_next[k] = next;
  } else {
    listAlone(touched, splat, box, next);
  }
  barrier();
  for (uint first = 0u; first < large_count; first += kParts) {
    if (local == 0u) most_rows = 0u;
    barrier();
    listTogether(first, part, lane);
  }
}

void main() {
  uint count = drawn_tally.count, groups = (count + 255u) / 256u;
  if (workGroup() == 0u) clearNextSpans();
  for (uint group = workGroup(); group < groups; group += workGroups()) {
    list(group, groups, count);
    barrier();
  }
}
