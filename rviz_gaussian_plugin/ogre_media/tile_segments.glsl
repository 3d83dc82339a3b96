// Long lists of tiles are cut into segments, which work groups blend side by side: a first one, whose
// transmittance the later ones know, and later ones, which tile_composite.comp lays over each other.
layout(std430) buffer Segments {
  uint later_groups[3], cut_groups[3];  // to dispatch: one a later segment, one a tile that is cut
  uint words[];                         // as below
} segments;
// Colour and transmittance, 256 a segment; a later one's transmittance is its own alone.
layout(std430) buffer FirstPartials { vec4 first_partials[]; };
layout(std430) buffer LaterPartials { vec4 later_partials[]; };

uniform uint first_segment, later_segment;  // splats in one
uniform uint most_cut;                      // tiles that may be cut

uint tileCount() { return uint(view.tiles.x * view.tiles.y); }

// Places in `words`: a tile's number among those that are cut; by this number, the tile, and the
// number of its first later segment; by the number of a later segment, that of its tile.
uint cutOf(uint tile) { return tile; }
uint tileOf(uint cut) { return tileCount() + 2u * cut; }
uint laterOf(uint cut) { return tileCount() + 2u * cut + 1u; }
uint ownerOf(uint later) { return tileCount() + 2u * most_cut + later; }

uint laterSegments(uint splats) {
  return splats <= first_segment ? 0u : (splats - first_segment + later_segment - 1u) / later_segment;
}
