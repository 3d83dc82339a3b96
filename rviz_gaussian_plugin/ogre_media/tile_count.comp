// Counts the tiles that drawn splats touch: each 32 splats in all, and the splats before each among its 32.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Drawn { uint drawn[]; };
layout(std430) writeonly buffer Within { uint within[]; };
layout(std430) writeonly buffer Counts { uint counts[]; };
layout(std430) readonly buffer Length { Tally drawn_tally; };
layout(std430) readonly buffer Boxes { uint boxes[]; };

uint touched(uint splat) {
  uint box = boxes[splat];
  if (box == 0u) return 0u;
  if (fillsItsBox(box)) return (box >> 20 & 63u) * (box >> 26);
  Outline outline = outlineOf(ellipse(splat));
  ivec2 rows = tileRows(outline);
  uint count = 0u;
  for (int row = rows.x; row < rows.y; ++row) {
    ivec2 columns = tileColumns(outline, row);
    count += uint(columns.y - columns.x);
  }
  return count;
}

shared uint sums[256];

void main() {
  uint i = invocation(), local = gl_LocalInvocationIndex, lane = local % kListed;
  uint mine = i < drawn_tally.count && drawn[i] != kNone ? touched(drawn[i]) : 0u, sum = mine;
  sums[local] = sum;
  barrier();
  for (uint reach = 1u; reach < kListed; reach *= 2u) {
    if (lane >= reach) sum += sums[local - reach];
    barrier();
    sums[local] = sum;
    barrier();
  }
  if (i < drawn_tally.count) within[i] = sum - mine;
  if (lane == kListed - 1u && i - lane < drawn_tally.count) counts[i / kListed] = sum;
}
