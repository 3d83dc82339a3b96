// Lists the splats that touch each tile, nearest first: those of a block a work group. Reports the counts of all
// shaders up to this one to the CPU.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Begins { uint begins[]; };
layout(std430) readonly buffer Touching { uint touching[]; };
layout(std430) readonly buffer Places { uint places[]; };  // where a macro tile's splats of a block go
layout(std430) writeonly buffer Listed { uint listed[]; };
layout(std430) readonly buffer Tallies { uint tallies[256]; };
layout(std430) writeonly buffer Report { uint report[]; };

uniform uint room;

const uint kParts = 8u;

shared uint splats[kBlockSplats];
shared uint words[kBlockSplats], to[kMacroTiles];  // of a macro tile

void listBlock(uint block) {
  uint local = gl_LocalInvocationIndex, i = kBlockSplats * block + local;
  uint part = local / 32u, lane = local % 32u, earlier = (1u << lane) - 1u;
  uint last = min(kBlockSplats * (block + 1u), macro_pairs.count) - 1u, last_macro = keyMacro(keys[last]);
  if (i <= last) splats[local] = splat_of[i];
  uint touches = touching[i];
  for (uint macro = keyMacro(keys[kBlockSplats * block]); macro <= last_macro; ++macro) {
    uint begin = begins[macro], end = begins[macro + 1u];
    if (begin == end) continue;
    words[local] = touches & bitsOf(block, local % kBlockWords, begin, end);
    if (local < kMacroTiles) to[local] = places[placeAt(block, macro, local)];
    barrier();
    for (uint tile = part; tile < kMacroTiles; tile += kParts) {
      uint next = to[tile];
      for (uint word = 0u; word < kBlockWords; ++word) {
        uint bits = words[kBlockWords * tile + word];
        if (bits == 0u) continue;
        uint place = next + uint(bitCount(bits & earlier));
        if ((bits >> lane & 1u) != 0u && place < room) listed[place] = splats[32u * word + lane];
        next += uint(bitCount(bits));
      }
    }
    barrier();
  }
}

void main() {
  if (workGroup() == 0u) report[gl_LocalInvocationIndex] = tallies[gl_LocalInvocationIndex];
  for (uint block = workGroup(); kBlockSplats * block < macro_pairs.count; block += workGroups()) {
    listBlock(block);
    barrier();
  }
}
