// A tile's long list is cut into segments, each blended by a work group: a first one, then later ones, which
// know the transmittance of the first. tile_composite.comp lays the results over each other.
#define SEGMENTS
layout(std430) buffer Segments {
  uint count;
  uint tiles[];  // of each segment; a tile's later segments follow its first one
} segments;
// Colour and transmittance of a segment's 256 pixels. A later segment's transmittance excludes the others'.
layout(std430) buffer Partials { vec4 partials[]; };

// Splats in one. With shorter first segments the last work groups end sooner, but more splats are blended that
// walls hide.
const uint kFirstSegment = 2048u, kLaterSegment = 1024u;

uint laterSegments(uint splats) {
  return splats <= kFirstSegment ? 0u : (splats - kFirstSegment + kLaterSegment - 1u) / kLaterSegment;
}
