// A splat's response along the rays of a picture: rosplat_core/views/conic.hpp derives it, and has the names.

// Lest a form be infinite. [px]
const float kLeastLength = 1e-5;

// right, down: how far a standard deviation moves the projection, by the splat's axes [px]; ahead: in depth, as a
// share of the depth.
struct Conic {
  float unit;                     // [px], lest float32 overflow; all lengths below are in this unit
  float xx, xy, yy, determinant;  // covariance, and its determinant
  vec2 g, tilt;
  float ahead, nearness;
};

Conic conicOf(vec3 right, vec3 down, vec3 ahead) {
  Conic c;
  c.unit = max(max(length(right), length(down)), kLeastLength);
  right /= c.unit;
  down /= c.unit;
  vec3 area = cross(right, down);
  c.xx = dot(right, right) + 1e-20;  // more than 0 for a splat without size, too
  c.xy = dot(right, down);
  c.yy = dot(down, down);
  c.determinant = dot(area, area);
  float over = 1.0 / max(c.determinant, 1e-30);  // more than 0 for a disc on edge, too
  c.g = vec2(dot(ahead, right), dot(ahead, down));
  c.ahead = dot(ahead, ahead);
  c.tilt = over * vec2(dot(cross(down, ahead), area), dot(cross(ahead, right), area));
  float volume = dot(ahead, area);
  c.nearness = over * volume * volume;
  return c;
}

// Whether an open outline at so many standard deviations misses the picture. The rays through it are those through
// the ellipsoid or through its mirror image behind the camera: each is beyond a side of the picture then.
bool missesPicture(vec2 centre, vec3 right, vec3 down, vec3 ahead, float sigmas) {
  vec4 past = vec4(centre, centre - vec2(view.picture));  // the left, top, right and bottom side
  bool misses = false, mirror_misses = false;
  for (int side = 0; side < 4; ++side) {
    float beyond = side < 2 ? -past[side] : past[side];
    float reach = sigmas * length((side % 2 == 0 ? right : down) + past[side] * ahead);
    misses = misses || beyond > reach;
    mirror_misses = mirror_misses || -beyond > reach;
  }
  return misses && mirror_misses;
}

// What turns the square of a distance in the picture into that of a pixel's ray, relative to a corner [px].
// xyz: 1 + tilt . offset, at a pixel's x, y and 1; w: nearness, for squares as falloffAxes() scales them.
vec4 tiltOf(Ellipse e, vec2 corner) {
  return vec4(e.tilt, 1.0 - dot(e.tilt, e.centre - corner), e.nearness / (kHalfLog2 * kHalfLog2));
}

float alongRay(vec4 tilt, vec2 pixel) { return tilt.x * pixel.x + (tilt.y * pixel.y + tilt.z); }

float squareOfRay(vec4 tilt, float along, float square) {
  return square / (along * along + tilt.w * square);
}

// The same of a pixel's offset from the middle of a disc's spot. [px]
float squareInSpot(vec2 away) { return kSpot * kHalfLog2 * kHalfLog2 * dot(away, away); }

// The depth at which a ray is nearest to the mean, over the mean's. What is behind the camera is met at the camera.
float depthOnRay(vec4 tilt, float along, float square) {
  return max(along, 0.0) / max(along * along + tilt.w * square, 1e-30);
}
