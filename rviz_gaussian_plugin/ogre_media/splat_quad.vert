#version 430
// One quad for each splat of the order, as large as the splat's 1/255 ellipse.

layout(std430, binding = 0) readonly buffer Order { uint order[]; };
// The projected buffer in as many parts as the driver's largest buffer asks for.
layout(std430, binding = 1) readonly buffer Projected { vec4 data[]; } projected[4];

uniform uint part_slots;  // slots in a part
uniform uint capacity;    // slots of the map as it is uploaded; an order may know more
uniform vec2 picture;     // [px]
uniform float up;         // 1, or -1 where the target's first row is the picture's top
uniform bool depth_mode;  // blend depths instead of colours

flat out vec4 colour;  // rgb, opacity
out vec2 sigmas;       // from the centre along the ellipse's axes

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
  if (depth_mode) colour.rgb = vec3(centre.w);
  vec2 corner = vec2((gl_VertexID & 1) * 2 - 1, (gl_VertexID >> 1) * 2 - 1);
  sigmas = corner * min(3.33, sqrt(2.0 * log(255.0 * colour.a)));
  vec2 pixel = centre.xy + sigmas.x * axes.xy + sigmas.y * axes.zw;
  vec2 ndc = 2.0 * pixel / picture - 1.0;
  gl_Position = vec4(ndc.x, -up * ndc.y, centre.z, 1.0);
}
