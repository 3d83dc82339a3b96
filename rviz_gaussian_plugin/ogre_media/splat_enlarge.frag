// A picture of half as many pixels each way in full size: between the four pixels around, of those
// at the same depths, so that what hides splats keeps its edges.

layout(binding = 0) uniform sampler2D half_colour;
layout(binding = 1) uniform sampler2D half_second;
layout(binding = 2) uniform sampler2D half_depth;
layout(binding = 3) uniform sampler2D full_depth;
layout(binding = 4) uniform sampler2D half_depth_behind;  // the same where there is none
layout(binding = 5) uniform sampler2D full_depth_behind;
uniform bool top_first;  // the first row is the picture's top
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 second;

const float kAlike = 0.1;  // of distances, nearly: of 1 - depth

vec4 difference(sampler2D halves, sampler2D fulls, vec2 place, ivec2 texel) {
  vec4 near = 1.0 - textureGather(halves, place);
  float here = 1.0 - texelFetch(fulls, texel, 0).r;
  return abs(near - here) - kAlike * max(near, vec4(here));
}

void main() {
  ivec2 size = textureSize(full_depth, 0), texel = ivec2(gl_FragCoord.xy);
  vec2 half_size = vec2(textureSize(half_colour, 0));
  // From the top: an odd row is half of one.
  vec2 place = 0.5 * (vec2(texel.x, top_first ? texel.y : size.y - 1 - texel.y) + 0.5);
  if (!top_first) place.y = half_size.y - place.y;
  vec2 part = fract(place - 0.5);
  place /= half_size;

  vec4 other = max(difference(half_depth, full_depth, place, texel),
                   difference(half_depth_behind, full_depth_behind, place, texel));
  if (all(lessThanEqual(other, vec4(0.0)))) {
    // With a level: derivatives mean nothing where neighbours go another way.
    colour = textureLod(half_colour, place, 0.0);
    second = textureLod(half_second, place, 0.0);
    return;
  }
  // As textureGather() goes round: from the lower left one counter-clockwise, but rows grow.
  vec4 weights = vec4((1.0 - part.x) * part.y, part.x * part.y, part.x * (1.0 - part.y),
                      (1.0 - part.x) * (1.0 - part.y));
  float least = min(min(other.x, other.y), min(other.z, other.w));
  weights *= vec4(lessThanEqual(other, vec4(max(least, 0.0))));
  weights /= dot(weights, vec4(1.0));
  for (int k = 0; k < 4; ++k) {
    // The component must be a constant.
    vec4 of_colour = k == 0   ? textureGather(half_colour, place, 0)
                     : k == 1 ? textureGather(half_colour, place, 1)
                     : k == 2 ? textureGather(half_colour, place, 2)
                              : textureGather(half_colour, place, 3);
    colour[k] = dot(weights, of_colour);
  }
  second = vec4(dot(weights, textureGather(half_second, place, 0)),
                dot(weights, textureGather(half_second, place, 1)), 0.0, 0.0);
}
