// Finds the slots of some pages that the picture may show, and projects their splats: 3D Gaussian -> ellipse in the
// picture, spherical harmonics -> colour. EWA splatting (Zwicker et al. 2001) as in Kerbl et al. 2023.

layout(local_size_x = 256) in;

// Spherical harmonics of bands 1 to 3: a word for each coefficient, 3, 5 and 7 a slot. In mode kChannel,
// which needs none, band1 holds the channel's values, a word a slot: some drivers have no further binding.
layout(std430) readonly buffer Band1 { uint band1[]; };
layout(std430) readonly buffer Band2 { uint band2[]; };
layout(std430) readonly buffer Band3 { uint band3[]; };
// What the splats are sorted by: grows with their depth; kNone for slots that the picture doesn't show. Of these, nothing
// else is written.
layout(std430) writeonly buffer Keys { uint keys[]; };
// boxOf() each splat; if nodes stand for some, from first_share on the share of each that is drawn.
layout(std430) writeonly buffer Boxes { uint boxes[]; };
layout(std430) buffer Seen { SeenTally seen; };
layout(std430) buffer OfLayers { uint seen_of_layer[]; };

uniform uint first_share;
uniform uint layer;
uniform bool one_layer;

const float kMostVariance = 1e16, kMostUnit = 1e18;  // beyond any picture, and soon beyond float32

#ifdef DEPTHS
vec2 plane;  // as in splat_depths.glsl, of the slot that is projected
#endif

shared uint group_seen, group_nearest, group_farthest;

mat3 rotationMatrix(vec4 q) {
  q = normalize(q);
  vec3 d = 2.0 * q.xyz;
  vec3 w = d * q.w, x = d * q.x;
  float yy = d.y * q.y, yz = d.y * q.z, zz = d.z * q.z;
  return mat3(1.0 - yy - zz, x.y + w.z, x.z - w.y,
              x.y - w.z, 1.0 - x.x - zz, yz + w.x,
              x.z + w.y, yz - w.x, 1.0 - x.x - yy);
}

// Clamps what is darker than black, but not what is brighter than white; no half float is NaN or infinite.
vec3 radiance(vec3 c) { return mix(vec3(0.0), min(c, vec3(65504.0)), greaterThan(c, vec3(0.0))); }

bool bandWanted(int band) { return band <= map.sh_degree && (map.only_band < 0 || band == map.only_band); }

// A coefficient of bands 1 to 3, as a fraction of the slot's unit.
vec3 coefficient(uint word) {
  return vec3(bitfieldExtract(int(word), 0, 11), bitfieldExtract(int(word), 11, 11),
              bitfieldExtract(int(word), 22, 10)) / vec3(1023.0, 1023.0, 511.0);
}

// Spherical harmonics in the group's frame (Kerbl et al. 2023).
vec3 trainedColour(uint slot, vec3 direction) {
  float x = direction.x, y = direction.y, z = direction.z;
  float xx = x * x, yy = y * y, zz = z * z;
  float basis[7];
  vec3 c = vec3(0.0);
  if (bandWanted(1)) {
    basis[0] = -0.4886025119029199 * y;
    basis[1] = 0.4886025119029199 * z;
    basis[2] = -0.4886025119029199 * x;
    for (uint k = 0u; k < 3u; ++k) c += basis[k] * coefficient(band1[3u * slot + k]);
  }
  if (bandWanted(2)) {
    basis[0] = 1.0925484305920792 * x * y;
    basis[1] = -1.0925484305920792 * y * z;
    basis[2] = 0.31539156525252005 * (2.0 * zz - xx - yy);
    basis[3] = -1.0925484305920792 * x * z;
    basis[4] = 0.5462742152960396 * (xx - yy);
    for (uint k = 0u; k < 5u; ++k) c += basis[k] * coefficient(band2[5u * slot + k]);
  }
  if (bandWanted(3)) {
    basis[0] = -0.5900435899266435 * y * (3.0 * xx - yy);
    basis[1] = 2.890611442640554 * x * y * z;
    basis[2] = -0.4570457994644658 * y * (4.0 * zz - xx - yy);
    basis[3] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    basis[4] = -0.4570457994644658 * x * (4.0 * zz - xx - yy);
    basis[5] = 1.445305721320277 * z * (xx - yy);
    basis[6] = -0.5900435899266435 * x * (xx - 3.0 * yy);
    for (uint k = 0u; k < 7u; ++k) c += basis[k] * coefficient(band3[7u * slot + k]);
  }
  c *= slotHarmonicsUnit(slot);
  if (bandWanted(0)) c += 0.28209479177387814 * slotColour(slot);
  return radiance(c + 0.5);
}

// Hues a golden angle apart; each three in turn are light, medium and dark.
vec3 categoryColour(int category) {
  uint number = uint(category);
  float hue = float(number * 2654435769u >> 8) / 16777216.0;
  uint tone = number % 3u;
  float saturation = tone == 0u ? 0.65 : tone == 1u ? 0.85 : 0.8;
  float value = tone == 0u ? 1.0 : tone == 1u ? 0.7 : 0.5;
  vec3 pure = clamp(abs(mod(6.0 * hue + vec3(0.0, 4.0, 2.0), 6.0) - 3.0) - 1.0, 0.0, 1.0);
  return value * (1.0 + saturation * (pure - 1.0));
}

vec3 channelColour(uint slot) {
  if (map.channel_colours == kNoColours) return vec3(0.5);
  uint bits = band1[slot];
  if ((bits & 0x7f800000u) == 0x7f800000u) return vec3(0.5);  // not finite: there is no value
  float value = uintBitsToFloat(bits);
  if (map.channel_colours == kCategories) {
    return categoryColour(int(floor(clamp(value, -1073741824.0, 1073741824.0) + 0.5)));
  }
  float above = clamp(value, map.channel_least, map.channel_most) - map.channel_least;
  return turbo(above * map.channel_per_range);
}

vec3 colour(uint slot, uint group, float depth, vec3 direction, vec3 scale, mat3 orientation,
            float opacity) {
  if (map.mode == kDepth) return depthColour(depth, map.depth_range);
  if (map.mode == kOpacity) return turbo(opacity);
  if (map.mode == kAge) return turbo(1.0 - slotAge(slot, view.now) / map.age_range);
  if (map.mode == kChannel) return channelColour(slot);
  if (map.mode == kNormals) {
    int shortest = scale.x <= scale.y && scale.x <= scale.z ? 0 : scale.y <= scale.z ? 1 : 2;
    vec3 normal = orientation[shortest];
    mat3 in_map = rotationOf(groups[group].to_box);
    return 0.5 + 0.5 * (in_map * (dot(normal, direction) > 0.0 ? -normal : normal));
  }
  return trainedColour(slot, direction);
}

#ifdef RAYS
// Whether nothing of a projected splat is in the picture. right, down, ahead: as conicOf() takes them.
bool isOutside(Ellipse e, vec3 right, vec3 down, vec3 ahead) {
  Outline outline = outlineOf(e);
  if (outline.reach.x == kEverywhere) return missesPicture(e.centre, right, down, ahead, cutoffSigmas(e.opacity));
  vec2 columns = columnRange(outline), rows = rowRange(outline);
  return !(columns.y > 0.0 && rows.y > 0.0 && columns.x < float(view.picture.x) && rows.x < float(view.picture.y));
}
#endif

// The ellipse of a slot, of opacity 0 where nothing of it is in the picture.
Ellipse project(Page page, uint slot, vec3 mean, vec3 p) {
#ifdef RAYS
  Ellipse e = Ellipse(vec2(0.0), p.z, vec2(0.0), 0.0, vec3(0.0), 0.0, map.kind, vec2(0.0), 0.0, false);
#else
  Ellipse e = Ellipse(vec2(0.0), p.z, vec2(0.0), 0.0, vec3(0.0), 0.0, map.kind);
#endif
  float trained_opacity = opacityUnit(page) * slotOpacity(slot);
  float opacity = map.opacity * trained_opacity;
  if (map.near_fade > 0.0) opacity *= min((p.z - view.clip.x) / map.near_fade, 1.0);

  // Rows of the projection's Jacobian; EWA's tangent is clamped as in training.
  vec3 jx, jy;
  e.centre = view.focal * p.xy / (view.orthographic ? 1.0 : p.z) + view.principal_point;
  if (view.orthographic) {
    jx = vec3(view.focal.x, 0.0, 0.0);
    jy = vec3(0.0, view.focal.y, 0.0);
  } else {
    vec2 slack = kTangentSlack * view.whole_picture / view.focal;
    vec2 tangent = clamp(p.xy / p.z, -view.whole_principal_point / view.focal - slack,
                         (view.whole_picture - view.whole_principal_point) / view.focal + slack);
#ifdef RAYS
    if (map.model >= kRay) tangent = p.xy / p.z;
#endif
    jx = vec3(view.focal.x, 0.0, -view.focal.x * tangent.x) / p.z;
    jy = vec3(0.0, view.focal.y, -view.focal.y * tangent.y) / p.z;
  }

  // Covariance in the picture: rows of J W R S times their transposes.
  vec3 scale = map.scale * slotScale(slot);
#ifdef RAYS
  if (map.model == kDisc && page.level == kNone) scale.z = 0.0;  // nodes have three scales
#endif
  if (map.mode == kBillboard) scale = vec3((scale.x + scale.y + scale.z) / 3.0);
  mat3 orientation = rotationMatrix(slotRotation(slot));
  mat3 axes = rotationOf(groups[page.group].to_camera) * orientation;
  vec3 right = (jx * axes) * scale;
  vec3 down = (jy * axes) * scale;
  float a, b, c, det, unit = 1.0;
#ifdef RAYS
  vec3 ahead = view.orthographic ? vec3(0.0) : vec3(axes[0].z, axes[1].z, axes[2].z) * scale / p.z;
  e.has_spot = map.model == kDisc;
  Conic conic = conicOf(right, down, ahead);
  if (map.model >= kRay) {
    a = conic.xx;
    b = conic.xy;
    c = conic.yy;
    det = conic.determinant;
    unit = conic.unit;
  } else
#endif
  {
    vec3 area = cross(right, down);
    float a0 = dot(right, right), c0 = dot(down, down);
    float det0 = dot(area, area);  // of M M^T by Cauchy-Binet: no cancellation for needles
    a = a0 + kLowPass;
    b = dot(right, down);
    c = c0 + kLowPass;
    det = det0 + kLowPass * (a0 + c0) + kLowPass * kLowPass;
    if (map.model == kEwaAntialiased) opacity *= sqrt(det0 / det);
#ifdef DEPTHS
    vec3 deeper = vec3(axes[0].z, axes[1].z, axes[2].z) * scale;
    vec2 of = vec2(dot(right, deeper), dot(down, deeper));
    plane = (vec2(c, a) * of - b * of.yx) / det;
#endif
  }
  if (!(opacity >= kCutoffAlpha)) return e;
  if (map.kind == kFlat || map.kind == kShaded) opacity = kBallOpacity;

  float mid = 0.5 * (a + c), radius = length(vec2(0.5 * (a - c), b));
  float major = mid + radius;
  float minor = det / major;
  if (!(major < kMostVariance && unit < kMostUnit)) return e;
  // Eigenvector of the larger eigenvalue, from whichever row is longer.
  vec2 axis = a > c ? vec2(radius + 0.5 * (a - c), b) : vec2(b, radius + 0.5 * (c - a));
  float norm = length(axis);
  axis = norm > 0.0 ? axis / norm : vec2(1.0, 0.0);

#ifdef RAYS
  e.major = max(unit * sqrt(major), kLeastLength) * axis;
  e.minor = max(unit * sqrt(minor), kLeastLength);
  if (map.model >= kRay) {
    // On edge, the covariance is all but singular and says little of the tilt along the minor axis, but for its bound.
    vec2 turned = vec2(-axis.y, axis.x);
    float along = dot(conic.g, axis) / sqrt(major);
    float most = sqrt(max(conic.ahead - along * along, 0.0)) / e.minor;
    e.tilt = clamp(dot(conic.tilt, turned) / unit, -most, most) * turned - along / length(e.major) * axis;
    e.nearness = conic.nearness;
  }
  e.opacity = opacity;
  if (isOutside(e, right, down, ahead)) {
    e.opacity = 0.0;
    return e;
  }
#else
  vec2 extent = cutoffSigmas(opacity) * sqrt(vec2(a, c));
  if (!all(greaterThan(e.centre + extent, vec2(0.0))) || !all(lessThan(e.centre - extent, vec2(view.picture)))) {
    return e;
  }
  e.major = sqrt(major) * axis;
  e.minor = sqrt(minor);
  e.opacity = opacity;
#endif
  vec3 eye = groups[page.group].eye.xyz;
  vec3 direction = view.orthographic ? eye : normalize(mean - eye);
  e.colour = colour(slot, page.group, p.z, direction, scale, orientation, trained_opacity);
  return e;
}

// Whether the picture may show a slot, p in the camera's frame: the sorters' test (rosplat_core/depth.py derives it),
// operation by operation, so that this shader and the sorters find the same slots.
bool mayBeSeen(Page page, uint slot, vec3 mean, vec3 p) {
  float opacity = opacityUnit(page) * slotOpacity(slot);
  if (!(opacity >= kCutoffAlpha) || !(map.opacity * opacity >= kCutoffAlpha)) return false;
  if (map.clip_to_box) {
    vec3 in_box = transformed(groups[page.group].to_box, mean);
    if (!all(lessThanEqual(abs(in_box), 0.5 * map.box_size))) return false;
  }
  vec3 scale = slotScale(slot);
  float extent = cutoffSigmas(opacity) * max(max(scale.x, scale.y), scale.z);
  float w = view.orthographic ? 1.0 : p.z;
  precise vec2 reach = view.half_size * w + map.slope * extent;
  precise vec2 along = abs(view.focal * p.xy + view.offset * w);
  return p.z > view.clip.x && p.z < view.clip.y && all(lessThanEqual(along, reach));
}

// Projects a slot, if the picture shows it. Returns the key of its depth, or kNone.
uint projected(Page page, uint slot, uint number) {
  vec3 mean = slotPosition(slot);
  vec3 p = transformed(groups[page.group].to_camera, mean);
  if (!mayBeSeen(page, slot, mean, p)) return kNone;
  float share = shareOf(page, slot, mean);
  if (!(share > 0.0)) return kNone;
#ifdef DEPTHS
  plane = vec2(0.0);
#endif
  Ellipse e = project(page, slot, mean, p);
  if (e.opacity == 0.0) return kNone;
  storeEllipse(number, packEllipse(e));
#ifdef DEPTHS
  planes[number] = plane;
#endif
  if (view.cut) boxes[first_share + number] = floatBitsToUint(share);
  boxes[number] = boxOf(outlineOf(e));
  return depthKey(p.z);
}

void main() {
  Page page = groupPage();
  uint local = gl_LocalInvocationIndex;
  if (local == 0u) {
    group_seen = 0u;
    group_nearest = kNone;
    group_farthest = 0u;
  }
  barrier();
  uint number = kPageSlots * page.number + slotInPage();
  uint key = projected(page, kPageSlots * page.page + slotInPage(), number);
  keys[number] = key;
  if (key != kNone) {
    atomicAdd(group_seen, 1u);
    atomicMin(group_nearest, key);
    atomicMax(group_farthest, key);
  }
  barrier();
  if (local > 0u || group_seen == 0u) return;
  atomicAdd(seen.count, group_seen);
  if (!one_layer) atomicAdd(seen_of_layer[layer], group_seen);
  // Most groups change nothing here, and learn so without an atomic operation.
  if (group_nearest < seen.nearest) atomicMin(seen.nearest, group_nearest);
  if (group_farthest > seen.farthest) atomicMax(seen.farthest, group_farthest);
  if (map.kind == kByDepth) {
    atomicMin(seen.nearest_coloured, group_nearest);
    atomicMax(seen.farthest_coloured, group_farthest);
  }
}
