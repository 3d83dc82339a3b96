// Finds which splats of the macro tiles' lists touch which tiles, a block a work group, and where lists begin.

layout(local_size_x = 256) in;
layout(std430) writeonly buffer Begins { uint begins[]; };      // of each macro tile's list
layout(std430) writeonly buffer Touching { uint touching[]; };
// How many splats of a block touch each tile. Where there are several macro tiles, tile_places.comp counts again.
layout(std430) writeonly buffer Places { uint places[]; };

// The masks of a block's splats, four in a word; rows of 32 splats begin in different banks of the memory.
const uint kRow = 32u / 4u + 1u;
shared uvec4 masks[kBlockWords * kRow];
shared uint counts[kMacroTiles];

// A bit for each tile of a macro tile that a splat touches. first: its first tile.
uint tilesTouched(uint key, uint splat, ivec2 first) {
  ivec2 rows = keyRows(key), columns = keyColumns(key);
  bool all = keyIsExact(key);
  Outline outline;
  if (!all) {
    outline = outlineOf(ellipse(splat));
    rows = clamp(tileRows(outline) - first.y, 0, kMacro.y);
  }
  uint mask = 0u;
  for (int row = rows.x; row < rows.y; ++row) {
    if (!all) columns = clamp(tileColumns(outline, first.y + row) - first.x, 0, kMacro.x);
    mask |= (1u << columns.y) - (1u << columns.x) << kMacro.x * row;
  }
  return mask;
}

void touchBlock(uint block) {
  uint local = gl_LocalInvocationIndex, i = kBlockSplats * block + local;
  uint columns = uint(macroTiles().x), macros = columns * uint(macroTiles().y), count = macro_pairs.count;
  uint mask = 0u;
  if (i < count) {
    uint key = keys[i], macro = keyMacro(key);
    for (uint next = i > 0u ? keyMacro(keys[i - 1u]) + 1u : 0u; next <= macro; ++next) begins[next] = i;
    for (uint next = macro + 1u; i + 1u == count && next <= macros; ++next) begins[next] = count;
    mask = tilesTouched(key, splat_of[i], kMacro * ivec2(int(macro % columns), int(macro / columns)));
  }
  masks[local / 32u * kRow + local % 32u / 4u][local % 4u] = mask;
  if (local < kMacroTiles) counts[local] = 0u;
  barrier();
  uint tile = local / kBlockWords, word = local % kBlockWords, bits = 0u;
  for (uint k = 0u; k < 8u; ++k) {
    uvec4 four = masks[kRow * word + k] >> tile;
    for (uint n = 0u; n < 4u; ++n) bits = bits >> 1 | four[n] << 31;
  }
  touching[kBlockSplats * block + local] = bits;
  atomicAdd(counts[tile], uint(bitCount(bits)));
  barrier();
  if (local < kMacroTiles) places[placeAt(block, keyMacro(keys[kBlockSplats * block]), local)] = counts[local];
}

void main() {
  for (uint block = workGroup(); kBlockSplats * block < macro_pairs.count; block += workGroups()) {
    touchBlock(block);
    barrier();
  }
}
