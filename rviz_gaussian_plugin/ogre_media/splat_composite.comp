// Lays the blended splats over what is in a texture. For canvases that are textures: cards for computing take
// many times as long to draw a triangle over the whole canvas.

layout(local_size_x = 256) in;
layout(binding = 0) uniform sampler2D splats;
layout(binding = 0, rgba8) uniform image2D canvas;
uniform ivec2 corner;  // of the viewport in the target [px]

void main() {
  ivec2 size = textureSize(splats, 0);
  ivec2 texel = ivec2(int(invocation()) % size.x, int(invocation()) / size.x);
  if (texel.y >= size.y) return;
  vec4 premultiplied = texelFetch(splats, texel, 0);
  if (premultiplied == vec4(0.0)) return;
  vec4 under = imageLoad(canvas, corner + texel);
  imageStore(canvas, corner + texel, premultiplied + (1.0 - premultiplied.a) * under);
}
