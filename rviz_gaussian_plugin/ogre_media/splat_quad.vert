#version 430
// One quad for each splat of the order, as large as the splat's 1/255 ellipse.

layout(std430, binding = 0) readonly buffer Order { uint order[]; };
// The projected buffer in as many parts as the driver's largest buffer asks for.
layout(std430, binding = 1) readonly buffer Projected { vec4 data[]; } projected[4];
layout(std430, binding = 5) readonly buffer DepthRange { uint nearest, farthest; };

uniform uint part_slots;  // slots in a part
uniform uint capacity;    // slots of the map as it is uploaded; an order may know more
uniform vec2 picture;     // [px]
uniform float up;         // 1, or -1 where the target's first row is the picture's top
uniform int mode;          // as in DrawMode
uniform bool raw_depth;    // blend depths [m] instead of colours
uniform vec2 depth_range;  // of mode kDepth [m]; empty: that of what is drawn

flat out vec4 colour;  // rgb, opacity
out vec2 sigmas;       // from the centre along the ellipse's axes

const int kDepth = 1;

// Google's Turbo, blue to red over 0 to 1 (polynomial of Mikhailov 2019).
vec3 turbo(float t) {
  t = clamp(t, 0.0, 1.0);
  vec4 v4 = vec4(1.0, t, t * t, t * t * t);
  vec2 v2 = v4.zw * v4.z;
  return clamp(vec3(dot(v4, vec4(0.13572138, 4.61539260, -42.66032258, 132.13108234)) +
                        dot(v2, vec2(-152.94239396, 59.28637943)),
                    dot(v4, vec4(0.09140261, 2.19418839, 4.84296658, -14.18503333)) +
                        dot(v2, vec2(4.27729857, 2.82956604)),
                    dot(v4, vec4(0.10667330, 12.64194608, -60.58204836, 110.36276771)) +
                        dot(v2, vec2(-89.90310912, 27.34824973))),
               0.0, 1.0);
}

vec4 fetch(uint part, uint i) {
  switch (part) {
    case 0u: return projected[0].data[i];
    case 1u: return projected[1].data[i];
    case 2u: return projected[2].data[i];
    default: return projected[3].data[i];
  }
}

void main() {
  uint slot = order[gl_InstanceID];
  uint part = slot / part_slots, i = 3u * (slot % part_slots);
  colour = slot < capacity ? fetch(part, i + 2u) : vec4(0.0);
  if (colour.a <= 0.0) {  // culled since it was ordered
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    sigmas = vec2(0.0);
    return;
  }
  vec4 centre = fetch(part, i), axes = fetch(part, i + 1u);
  if (raw_depth) {
    colour.rgb = vec3(centre.w);
  } else if (mode == kDepth) {
    vec2 range = depth_range.y > depth_range.x ? depth_range
                                               : uintBitsToFloat(uvec2(nearest, farthest));
    colour.rgb = turbo(1.0 - (centre.w - range.x) / max(range.y - range.x, 1e-6));
  }
  vec2 corner = vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID >> 1) * 2 - 1);
  sigmas = corner * min(3.33, sqrt(2.0 * log(255.0 * colour.a)));
  vec2 pixel = centre.xy + sigmas.x * axes.xy + sigmas.y * axes.zw;
  vec2 ndc = 2.0 * pixel / picture - 1.0;
  gl_Position = vec4(ndc.x, -up * ndc.y, centre.z, 1.0);
}
