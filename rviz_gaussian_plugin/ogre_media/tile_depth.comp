// For each tile, the nearest depth of a translucent object before the opaque scene, and the farthest depth of
// `divided`: splats behind objects lie beyond the first depth, splats before objects lie before the second.

layout(local_size_x = 16, local_size_y = 16) in;
layout(binding = 0) uniform sampler2D divided;  // depth of the nearest object, translucent or opaque
layout(binding = 1) uniform sampler2D scene_depth;
layout(binding = 0) writeonly uniform image2D tile_depths;


shared uint nearest, farthest;

void main() {
  ivec2 tile = groupTile();
  if (tile.y >= view.tiles.y) return;
  if (gl_LocalInvocationIndex == 0u) {
    nearest = floatBitsToUint(2.0);
    farthest = 0u;
  }
  barrier();
  ivec2 pixel = tile * kTile + ivec2(gl_LocalInvocationID.xy);
  if (all(lessThan(pixel, view.picture))) {
    ivec2 texel = texelOf(pixel, view.picture.y, view.top_first);
    float depth = texelFetch(divided, texel, 0).r;
    atomicMax(farthest, floatBitsToUint(depth));
    if (depth < texelFetch(scene_depth, texel, 0).r) atomicMin(nearest, floatBitsToUint(depth));
  }
  barrier();
  if (gl_LocalInvocationIndex == 0u) {
    imageStore(tile_depths, tile,
               vec4(uintBitsToFloat(nearest), uintBitsToFloat(farthest), 0.0, 0.0));
  }
}
