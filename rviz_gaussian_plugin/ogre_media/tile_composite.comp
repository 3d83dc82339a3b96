// Lays the segments of tiles that are cut over each other, nearest first.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Lists { TileList lists[]; };
layout(binding = 0) writeonly uniform image2D blended;

void main() {
  uint segment = workGroup(), local = gl_LocalInvocationIndex;
  if (segment >= segments.count) return;
  uint tile = segments.tiles[segment];
  TileList list = lists[tile];
  if (list.first_segment != segment) return;
  uint later = laterSegments(list.end - list.begin);
  ivec2 pixel = tileAt(tile) * kTile + pixelInTile(local);
  vec4 first = partials[256u * segment + local];
  vec3 colour = first.rgb;
  float transmittance = first.a;
  for (uint n = 1u; n <= later && transmittance >= kTransparentInTiles; ++n) {
    vec4 partial = partials[256u * (segment + n) + local];
    colour += transmittance * partial.rgb;
    transmittance *= partial.a;
  }
  if (any(greaterThanEqual(pixel, view.picture))) return;
  imageStore(blended, texelOf(pixel, view.picture.y, view.top_first), vec4(colour, 1.0 - transmittance));
}
