// A tile's long list is cut into segments, each blended by a work group: a first one, then later ones, which
// know the transmittance of the first. tile_composite.comp lays the results over each other.
layout(std430) buffer Segments {
  uint later_groups[3], cut_groups[3];  // to dispatch: a work group a later segment, one a cut tile
  uint words[];                         // as below
} segments;
// Colour and transmittance of a segment's 256 pixels. A later segment's transmittance excludes the others'.
layout(std430) buffer FirstPartials { vec4 first_partials[]; };
layout(std430) buffer LaterPartials { vec4 later_partials[]; };

uniform uint first_segment, later_segment;  // splats in one
uniform uint most_cut;                      // tiles that may be cut

uint tileCount() { return uint(view.tiles.x * view.tiles.y); }

// Indices in `words` of: a tile's number among the cut tiles; by this number, the tile and the number of its
// first later segment; by the number of a later segment, the number of its tile among the cut tiles.
uint cutOf(uint tile) { return tile; }
uint tileOf(uint cut) { return tileCount() + 2u * cut; }
uint laterOf(uint cut) { return tileCount() + 2u * cut + 1u; }
uint ownerOf(uint later) { return tileCount() + 2u * most_cut + later; }

uint laterSegments(uint splats) {
  return splats <= first_segment ? 0u : (splats - first_segment + later_segment - 1u) / later_segment;
}
