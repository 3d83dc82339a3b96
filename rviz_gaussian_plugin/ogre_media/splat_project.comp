#version 430
// Projects the splats of one page: 3D Gaussian -> ellipse in the picture, spherical harmonics -> colour.
// EWA splatting (Zwicker et al. 2001) as in Kerbl et al. 2023.

layout(local_size_x = 256) in;

// Per slot: position.xyz opacity | orientation xyzw | scale.xyz time of its last change [s]
layout(std430, binding = 0) readonly buffer Geometry { vec4 geometry[]; };
// Spherical harmonics, a buffer for each band, RGB interleaved: 3, 9, 15, 21 floats a slot.
layout(std430, binding = 1) readonly buffer Band0 { float band0[]; };
layout(std430, binding = 2) readonly buffer Band1 { float band1[]; };
layout(std430, binding = 3) readonly buffer Band2 { float band2[]; };
layout(std430, binding = 4) readonly buffer Band3 { float band3[]; };
// Per slot: centre.xy [px] ndc.z depth [m] | axes of one sigma [px] | colour.rgb opacity
layout(std430, binding = 5) writeonly buffer Projected { vec4 projected[]; };
// Nearest and farthest depth drawn, as float bits.
layout(std430, binding = 6) buffer DepthRange { uint nearest, farthest; };

uniform uint first_slot;  // of this page in the projected buffer
uniform uint slot_count;
uniform mat4 model_view;  // map -> camera: x right, y down, z forward
uniform vec3 eye;         // the camera in the map's frame; orthographic: its forward direction
uniform bool orthographic;
uniform vec2 focal;            // [px], orthographic [px/m]
uniform vec2 principal_point;  // [px]
uniform vec2 picture;          // [px]
uniform vec2 clip;             // near, far [m]
uniform vec2 ndc_depth;        // ndc.z = (x z + y) / w
uniform int sh_degree;
uniform int only_band;  // -1: all
uniform bool antialiased;
uniform int mode;
uniform float scale_modifier, opacity_modifier;
uniform float near_fade;  // [m]
uniform vec2 age;         // now, and how long is old [s]
uniform bool clip_to_box;
uniform vec3 box_centre, box_size;  // [m]

// As in DrawMode.
const int kDepth = 1, kBillboard = 2, kNormals = 5, kOpacity = 6, kAge = 7;

const float kLowPass = 0.3;          // [px^2], part of the trained model
const float kCutoffAlpha = 1.0 / 255.0;
const float kMaxSigmas = 3.33;

mat3 rotationMatrix(vec4 q) {
  q = normalize(q);
  vec3 d = 2.0 * q.xyz;
  vec3 w = d * q.w, x = d * q.x;
  float yy = d.y * q.y, yz = d.y * q.z, zz = d.z * q.z;
  return mat3(1.0 - yy - zz, x.y + w.z, x.z - w.y,
              x.y - w.z, 1.0 - x.x - zz, yz + w.x,
              x.z + w.y, yz - w.x, 1.0 - x.x - yy);
}

// Never darker than black, but brighter than white may be; and no NaN or infinity in half floats.
vec3 radiance(vec3 c) { return mix(vec3(0.0), min(c, vec3(65504.0)), greaterThan(c, vec3(0.0))); }

bool bandWanted(int band) { return band <= sh_degree && (only_band < 0 || band == only_band); }

// Spherical harmonics in the map's frame (Kerbl et al. 2023).
vec3 trainedColour(uint slot, vec3 direction) {
  float x = direction.x, y = direction.y, z = direction.z;
  float xx = x * x, yy = y * y, zz = z * z;
  float basis[7];
  vec3 c = vec3(0.5);
  if (bandWanted(0)) {
    uint i = slot * 3u;
    c += 0.28209479177387814 * vec3(band0[i], band0[i + 1u], band0[i + 2u]);
  }
  if (bandWanted(1)) {
    basis[0] = -0.4886025119029199 * y;
    basis[1] = 0.4886025119029199 * z;
    basis[2] = -0.4886025119029199 * x;
    uint i = slot * 9u;
    for (uint k = 0u; k < 3u; ++k, i += 3u)
      c += basis[k] * vec3(band1[i], band1[i + 1u], band1[i + 2u]);
  }
  if (bandWanted(2)) {
    basis[0] = 1.0925484305920792 * x * y;
    basis[1] = -1.0925484305920792 * y * z;
    basis[2] = 0.31539156525252005 * (2.0 * zz - xx - yy);
    basis[3] = -1.0925484305920792 * x * z;
    basis[4] = 0.5462742152960396 * (xx - yy);
    uint i = slot * 15u;
    for (uint k = 0u; k < 5u; ++k, i += 3u)
      c += basis[k] * vec3(band2[i], band2[i + 1u], band2[i + 2u]);
  }
  if (bandWanted(3)) {
    basis[0] = -0.5900435899266435 * y * (3.0 * xx - yy);
    basis[1] = 2.890611442640554 * x * y * z;
    basis[2] = -0.4570457994644658 * y * (4.0 * zz - xx - yy);
    basis[3] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    basis[4] = -0.4570457994644658 * x * (4.0 * zz - xx - yy);
    basis[5] = 1.445305721320277 * z * (xx - yy);
    basis[6] = -0.5900435899266435 * x * (xx - 3.0 * yy);
    uint i = slot * 21u;
    for (uint k = 0u; k < 7u; ++k, i += 3u)
      c += basis[k] * vec3(band3[i], band3[i + 1u], band3[i + 2u]);
  }
  return radiance(c);
}

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

vec3 colour(uint slot, vec3 direction, vec3 scale, mat3 rotation, float opacity) {
  if (mode == kOpacity) return turbo(opacity);
  if (mode == kAge) return turbo(1.0 - (age.x - geometry[3u * slot + 2u].w) / age.y);
  if (mode == kNormals) {
    int shortest = scale.x <= scale.y && scale.x <= scale.z ? 0 : scale.y <= scale.z ? 1 : 2;
    vec3 normal = rotation[shortest];
    return 0.5 + 0.5 * (dot(normal, direction) > 0.0 ? -normal : normal);
  }
  return trainedColour(slot, direction);
}

void main() {
  uint slot = gl_GlobalInvocationID.x;
  if (slot >= slot_count) return;
  uint target = 3u * (first_slot + slot);
  vec4 mean_opacity = geometry[3u * slot];
  vec3 mean = mean_opacity.xyz;
  float opacity = opacity_modifier * mean_opacity.w;
  vec3 p = (model_view * vec4(mean, 1.0)).xyz;

  projected[target + 1u] = vec4(0.0);  // no axes: not drawn
  projected[target + 2u] = vec4(0.0);
  if (!(opacity >= kCutoffAlpha) || !(p.z > clip.x) || !(p.z < clip.y)) return;

  if (clip_to_box && any(greaterThan(abs(mean - box_centre), 0.5 * box_size))) return;
  if (near_fade > 0.0) opacity *= min((p.z - clip.x) / near_fade, 1.0);

  // Rows of the projection's Jacobian; the tangent is clamped as in training.
  vec3 jx, jy;
  vec2 centre;
  float w = orthographic ? 1.0 : p.z;
  centre = focal * p.xy / w + principal_point;
  if (orthographic) {
    jx = vec3(focal.x, 0.0, 0.0);
    jy = vec3(0.0, focal.y, 0.0);
  } else {
    vec2 slack = 0.15 * picture / focal;  // 0.3 tan(fov / 2)
    vec2 tangent = clamp(p.xy / p.z, -principal_point / focal - slack,
                         (picture - principal_point) / focal + slack);
    jx = vec3(focal.x, 0.0, -focal.x * tangent.x) / p.z;
    jy = vec3(0.0, focal.y, -focal.y * tangent.y) / p.z;
  }

  // Covariance in the picture: rows of J W R S times their transposes.
  vec3 scale = scale_modifier * geometry[3u * slot + 2u].xyz;
  if (mode == kBillboard) scale = vec3((scale.x + scale.y + scale.z) / 3.0);
  mat3 rotation = rotationMatrix(geometry[3u * slot + 1u]);
  mat3 axes = mat3(model_view) * rotation;
  vec3 mx = (jx * axes) * scale;
  vec3 my = (jy * axes) * scale;
  vec3 area = cross(mx, my);
  float a0 = dot(mx, mx), b = dot(mx, my), c0 = dot(my, my);
  float det0 = dot(area, area);  // of M M^T by Cauchy-Binet: no cancellation for needles
  float a = a0 + kLowPass, c = c0 + kLowPass;
  float det = det0 + kLowPass * (a0 + c0) + kLowPass * kLowPass;
  if (antialiased) opacity *= sqrt(det0 / det);
  if (!(opacity >= kCutoffAlpha)) return;

  float mid = 0.5 * (a + c), radius = length(vec2(0.5 * (a - c), b));
  float major = mid + radius;
  float minor = det / major;
  if (!(major < 1e16)) return;  // beyond any picture, and soon beyond float32
  // Eigenvector of the larger eigenvalue, from whichever row is longer.
  vec2 axis = a > c ? vec2(radius + 0.5 * (a - c), b) : vec2(b, radius + 0.5 * (c - a));
  float norm = length(axis);
  axis = norm > 0.0 ? axis / norm : vec2(1.0, 0.0);

  float sigmas = min(kMaxSigmas, sqrt(2.0 * log(255.0 * opacity)));
  vec2 extent = sigmas * sqrt(vec2(a, c));
  if (!all(greaterThan(centre + extent, vec2(0.0))) || !all(lessThan(centre - extent, picture))) return;

  vec3 direction = orthographic ? eye : normalize(mean - eye);
  projected[target] = vec4(centre, (ndc_depth.x * p.z + ndc_depth.y) / w, p.z);
  projected[target + 1u] = vec4(sqrt(major) * axis, sqrt(minor) * vec2(-axis.y, axis.x));
  projected[target + 2u] =
      vec4(colour(slot, direction, scale, rotation, mean_opacity.w), opacity);
  if (mode == kDepth) {
    atomicMin(nearest, floatBitsToUint(max(p.z, 0.0)));
    atomicMax(farthest, floatBitsToUint(max(p.z, 0.0)));
  }
}
