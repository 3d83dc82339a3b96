#version 430
// Projects the splats of one page: 3D Gaussian -> ellipse in the picture, spherical harmonics -> colour.
// EWA splatting (Zwicker et al. 2001) as in Kerbl et al. 2023.

layout(local_size_x = 256) in;

// Per slot: position.xyz opacity | orientation xyzw | scale.xyz unused
layout(std430, binding = 0) readonly buffer Geometry { vec4 geometry[]; };
// Spherical harmonics, a buffer for each band, RGB interleaved: 3, 9, 15, 21 floats a slot.
layout(std430, binding = 1) readonly buffer Band0 { float band0[]; };
layout(std430, binding = 2) readonly buffer Band1 { float band1[]; };
layout(std430, binding = 3) readonly buffer Band2 { float band2[]; };
layout(std430, binding = 4) readonly buffer Band3 { float band3[]; };
// Per slot: centre.xy [px] ndc.z depth [m] | axes of one sigma [px] | colour.rgb opacity
layout(std430, binding = 5) writeonly buffer Projected { vec4 projected[]; };

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
uniform bool antialiased;

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

vec3 colour(uint slot, vec3 direction) {
  uint i = slot * 3u;
  vec3 c = 0.28209479177387814 * vec3(band0[i], band0[i + 1u], band0[i + 2u]);
  if (sh_degree < 1) return radiance(c + 0.5);
  float x = direction.x, y = direction.y, z = direction.z;
  float basis[7];
  i = slot * 9u;
  basis[0] = -0.4886025119029199 * y;
  basis[1] = 0.4886025119029199 * z;
  basis[2] = -0.4886025119029199 * x;
  for (uint k = 0u; k < 3u; ++k, i += 3u)
    c += basis[k] * vec3(band1[i], band1[i + 1u], band1[i + 2u]);
  if (sh_degree < 2) return radiance(c + 0.5);
  float xx = x * x, yy = y * y, zz = z * z;
  i = slot * 15u;
  basis[0] = 1.0925484305920792 * x * y;
  basis[1] = -1.0925484305920792 * y * z;
  basis[2] = 0.31539156525252005 * (2.0 * zz - xx - yy);
  basis[3] = -1.0925484305920792 * x * z;
  basis[4] = 0.5462742152960396 * (xx - yy);
  for (uint k = 0u; k < 5u; ++k, i += 3u)
    c += basis[k] * vec3(band2[i], band2[i + 1u], band2[i + 2u]);
  if (sh_degree < 3) return radiance(c + 0.5);
  i = slot * 21u;
  basis[0] = -0.5900435899266435 * y * (3.0 * xx - yy);
  basis[1] = 2.890611442640554 * x * y * z;
  basis[2] = -0.4570457994644658 * y * (4.0 * zz - xx - yy);
  basis[3] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
  basis[4] = -0.4570457994644658 * x * (4.0 * zz - xx - yy);
  basis[5] = 1.445305721320277 * z * (xx - yy);
  basis[6] = -0.5900435899266435 * x * (xx - 3.0 * yy);
  for (uint k = 0u; k < 7u; ++k, i += 3u)
    c += basis[k] * vec3(band3[i], band3[i + 1u], band3[i + 2u]);
  return radiance(c + 0.5);
}

void main() {
  uint slot = gl_GlobalInvocationID.x;
  if (slot >= slot_count) return;
  uint target = 3u * (first_slot + slot);
  vec4 mean_opacity = geometry[3u * slot];
  vec3 mean = mean_opacity.xyz;
  float opacity = mean_opacity.w;
  vec3 p = (model_view * vec4(mean, 1.0)).xyz;

  projected[target + 1u] = vec4(0.0);  // no axes: not drawn
  projected[target + 2u] = vec4(0.0);
  if (!(opacity >= kCutoffAlpha) || !(p.z > clip.x) || !(p.z < clip.y)) return;

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
  vec3 scale = geometry[3u * slot + 2u].xyz;
  mat3 axes = mat3(model_view) * rotationMatrix(geometry[3u * slot + 1u]);
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
  projected[target + 2u] = vec4(colour(slot, direction), opacity);
}
