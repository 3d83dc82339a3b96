// Which splats of a macro tile's list touch which of its tiles. Lists follow each other, and are cut into blocks of
// 256 splats. Each of the 32 tiles of a macro tile has 8 words of bits in a block, for the splats of all macro tiles
// that have some there.

layout(std430) readonly buffer Keys { uint keys[]; };        // macroKey()s, sorted by macro tile
layout(std430) readonly buffer Splats { uint splat_of[]; };  // nearest first
layout(std430) readonly buffer MacroPairs { Tally macro_pairs; };

const uint kBlockSplats = 256u, kBlockWords = 8u, kMacroTiles = uint(kMacro.x * kMacro.y);

uint wordAt(uint block, uint tile) { return kBlockSplats * block + kBlockWords * tile; }
// What a macro tile's tiles have in a block.
uint placeAt(uint block, uint macro, uint tile) { return kMacroTiles * (block + macro) + tile; }

// The bits of a block's word that are of splats from `begin` to `end`.
uint bitsOf(uint block, uint word, uint begin, uint end) {
  uint first = kBlockSplats * block + 32u * word;
  if (end <= first || begin >= first + 32u) return 0u;
  uint bits = kNone << (max(begin, first) - first);
  return end < first + 32u ? bits & ((1u << (end - first)) - 1u) : bits;
}
