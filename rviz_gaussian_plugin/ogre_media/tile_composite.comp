// Lays the segments of cut tiles over each other, nearest first.

layout(local_size_x = 256) in;
layout(std430) readonly buffer Begins { uint begins[]; };
layout(binding = 0) writeonly uniform image2D blended;

void main() {
  uint cut = workGroup(), local = gl_LocalInvocationIndex;
  uint tile = segments.words[tileOf(cut)], later = segments.words[laterOf(cut)];
  uint count = laterSegments(begins[tile + 1u] - begins[tile]);
  ivec2 pixel = tileAt(tile) * kTile + pixelInTile(local);
  vec4 first = first_partials[256u * cut + local];
  vec3 colour = first.rgb;
  float transmittance = first.a;
  for (uint n = 0u; n < count && transmittance >= kTransparentInTiles; ++n) {
    vec4 partial = later_partials[256u * (later + n) + local];
    colour += transmittance * partial.rgb;
    transmittance *= partial.a;
  }
  if (any(greaterThanEqual(pixel, view.picture))) return;
  imageStore(blended, texelOf(pixel, view.picture.y, view.top_first), vec4(colour, 1.0 - transmittance));
}
