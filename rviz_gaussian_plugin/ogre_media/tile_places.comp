// Finds where each tile's splats go, block by block: a macro tile a work group. Cuts long lists into segments.

layout(local_size_x = 1024) in;
layout(std430) readonly buffer Begins { uint begins[]; };
layout(std430) readonly buffer Touching { uint touching[]; };
layout(std430) buffer Places { uint places[]; };  // as tile_touch.comp has them; then where these splats go
layout(std430) writeonly buffer Lists { TileList lists[]; };
layout(std430) buffer Wanted { uint wanted_splats, wanted_segments; };  // if there were room for all

uniform uint room, segments_room;

const uint kParts = 1024u / kMacroTiles;  // of a list, counted at the same time

shared uint sums[kParts][kMacroTiles];
shared uint first_place;

// Returns the first segment of a tile's list, kNone if it stays whole.
uint cut(uint number, uint length) {
  uint later = laterSegments(length);
  if (later == 0u) return kNone;
  uint first = atomicAdd(wanted_segments, later + 1u);
  if (first + later >= segments_room) return kNone;
  atomicAdd(segments.count, later + 1u);
  for (uint n = 0u; n <= later; ++n) segments.tiles[first + n] = number;
  return first;
}

// How many splats of a block touch a tile of a macro tile.
uint countIn(uint block, uint macro, uint tile, uint begin, uint end) {
  uint first = kBlockSplats * block, count = 0u;
  if (begin <= first && first + kBlockSplats <= end) return places[placeAt(block, macro, tile)];
  for (uint word = 0u; word < kBlockWords; ++word) {
    count += uint(bitCount(touching[wordAt(block, tile) + word] & bitsOf(block, word, begin, end)));
  }
  return count;
}

void main() {
  uint macro = workGroup(), tile = gl_LocalInvocationIndex % kMacroTiles, part = gl_LocalInvocationIndex / kMacroTiles;
  ivec2 columns = macroTiles();
  if (macro >= uint(columns.x * columns.y)) return;
  uint begin = 0u, end = 0u;
  if (macro_pairs.count > 0u) {  // else nothing has found where lists begin
    begin = begins[macro];
    end = begins[macro + 1u];
  }
  uint first = begin / kBlockSplats, blocks = end > begin ? (end - 1u) / kBlockSplats - first + 1u : 0u;
  uint each = (blocks + kParts - 1u) / kParts, from = first + min(part * each, blocks);
  uint to = first + min((part + 1u) * each, blocks), sum = 0u;
  for (uint block = from; block < to; ++block) sum += countIn(block, macro, tile, begin, end);
  sums[part][tile] = sum;
  barrier();
  uint place = 0u, length = 0u, before = 0u, all = 0u;
  for (uint k = 0u; k < kParts; ++k) {
    if (k < part) place += sums[k][tile];
    length += sums[k][tile];
  }
  barrier();
  if (part == 0u) sums[0][tile] = length;
  barrier();
  for (uint k = 0u; k < kMacroTiles; ++k) {
    if (k < tile) before += sums[0][k];
    all += sums[0][k];
  }
  if (gl_LocalInvocationIndex == 0u) first_place = atomicAdd(wanted_splats, all);
  barrier();
  before += first_place;
  place += before;
  for (uint block = from; block < to; ++block) {
    uint count = countIn(block, macro, tile, begin, end);
    places[placeAt(block, macro, tile)] = place;
    place += count;
  }
  ivec2 at = kMacro * ivec2(int(macro) % columns.x, int(macro) / columns.x) +
             ivec2(int(tile) % kMacro.x, int(tile) / kMacro.x);
  if (part > 0u || any(greaterThanEqual(at, view.tiles))) return;
  uint number = tileNumber(at), listed = min(before + length, room) - min(before, room);
  lists[number] = TileList(before, before + listed, cut(number, listed));
}
