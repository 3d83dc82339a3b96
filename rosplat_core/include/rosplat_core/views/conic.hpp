#pragma once

// A splat's response along the rays of a picture, as six numbers of the splat.
//
// How it works
//
// The mean m projects to the pixel p. A ray through p + d has the direction r(d), r(0) = m / z.
// With M = G diag(s), the splat's axes in the camera's frame, every point of the splat's sigma
// ellipsoid is m + M b with |b| = 1. Seen from the camera along m, M has three rows:
//
//   right, down   how far a step b moves the point's projection, to first order [px]: the rows of
//                 J W G diag(s), J the derivative of the projection at m. Tangents aren't clamped.
//   ahead         how far b moves the point in depth, as a share of z: the third row of M, over z
//
// So (right, down, ahead) is the splat in coordinates in which the camera looks along m, and
//
//   S = [right.right, right.down; down.right, down.down]     the ellipse that EWA draws, unfiltered
//   g = (ahead.right, ahead.down)
//   tilt = -S^-1 g                                           [1/px]
//   nearness = ahead.ahead - g' S^-1 g = 1 / D^2,            D: the camera's own distance from the
//                                                            mean in standard deviations
//
// The squared distance of a ray from the mean, in standard deviations, is then exactly
//
//   d' S^-1 d / ((1 + tilt.d)^2 + nearness d' S^-1 d)
//
// and the response is opacity exp(-half of it). The ray is nearest to the mean at the depth
//
//   z (1 + tilt.d) / ((1 + tilt.d)^2 + nearness d' S^-1 d)
//
// A flat splat has nearness 0; the formula is then the ray's intersection with the disc. With tilt
// and nearness 0 it is an ellipse in the picture: EWA, and what parallel rays see.
//
// Where the response is at least 1/255, the distance is at most c, c^2 = 2 ln(255 opacity). This is
// another ellipse, from the dual conic m m' - c^2 M M' by completing squares:
//
//   w = 1 - c^2 ahead.ahead,  centre -c^2 g / w,  covariance S / w + c^2 g g' / w^2, at c
//   deviations
//
// while w > 0: the ellipsoid of c deviations is in front of the camera's plane z = 0. Else the
// outline is open. Closed or open, it ends, to the right of p, where a plane through the camera
// touches the ellipsoid: the line at d of the dual conic, w d^2 + 2 c^2 g_x d - c^2 S_xx = 0, so
//
//   d = c^2 S_xx / (sqrt(c^2 S_xx - c^4 |right x ahead|^2) + c^2 g_x)
//
// and nowhere if the root is imaginary or the divisor is not more than 0. To the left, -g_x. Rays
// are whole lines, as in gsplat, so an open outline has a mirror image, of what is behind the
// camera. It begins at the other root. All sums are of squares or of products of cross products, so
// that float32 holds needles and discs.
//
// 2DGS gives each disc a spot around the centre of its outline at one deviation, of half a pixel's
// variance: the distance of which the smaller one counts is kSpot times the square of the offset.
//
// Real: a float, a double, or a vector of floats (simd.hpp), so plain operators alone.
// splat_conic.glsl and rosplat_lab/reference/conics.py have the same.

#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

constexpr float kUnbounded = 1e9f;  // more than any picture [px]

template <typename Real>
struct Rows {
  Real right[3], down[3], ahead[3];
};

template <typename Real>
struct Conic {
  Real xx, xy, yy;   // S [px^2]
  Real determinant;  // of S
  Real g[2];         // [px]
  Real ahead;        // ahead.ahead
  Real aside[2];     // |right x ahead|^2, |down x ahead|^2 [px^2]
  Real tilt[2];      // [1/px]
  Real nearness;
};

// An ellipse around p + (x, y).
template <typename Real>
struct Outline {
  Real x, y;         // [px]
  Real xx, xy, yy;   // covariance [px^2]
  Real determinant;  // of the covariance
  Real w;            // the other numbers mean nothing where it is less than kLeastAhead
};

// How far an outline reaches from p: 0 to kUnbounded. [px]
template <typename Real>
struct Reach {
  Real left, right, up, down;
  Real mirror_x, mirror_y;  // where its mirror image begins, from p on; 0 where that is anywhere
};

namespace conic {

template <typename Real>
Real dot(const Real (&a)[3], const Real (&b)[3]) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

template <typename Real>
void cross(const Real (&a)[3], const Real (&b)[3], Real (&into)[3]) {
  into[0] = a[1] * b[2] - a[2] * b[1];
  into[1] = a[2] * b[0] - a[0] * b[2];
  into[2] = a[0] * b[1] - a[1] * b[0];
}

}  // namespace conic

template <typename Real>
Conic<Real> conicOf(const Rows<Real>& rows) {
  using conic::cross;
  using conic::dot;
  Real area[3], below[3], beside[3];
  cross(rows.right, rows.down, area);
  cross(rows.down, rows.ahead, below);
  cross(rows.ahead, rows.right, beside);
  Conic<Real> c;
  c.xx = dot(rows.right, rows.right);
  c.xy = dot(rows.right, rows.down);
  c.yy = dot(rows.down, rows.down);
  c.determinant = dot(area, area) + 1e-30f;  // more than 0 for a disc on edge, too
  c.g[0] = dot(rows.ahead, rows.right);
  c.g[1] = dot(rows.ahead, rows.down);
  c.ahead = dot(rows.ahead, rows.ahead);
  c.aside[0] = dot(beside, beside);
  c.aside[1] = dot(below, below);
  const Real over = 1.0f / c.determinant;
  c.tilt[0] = dot(below, area) * over;
  c.tilt[1] = dot(beside, area) * over;
  const Real volume = dot(rows.ahead, area);
  c.nearness = volume * volume * over;
  return c;
}

// cut2: the square of c.
template <typename Real>
Outline<Real> outlineOf(const Conic<Real>& c, Real cut2) {
  Outline<Real> o;
  o.w = 1.0f - cut2 * c.ahead;
  const Real over = 1.0f / o.w, more = cut2 * over * over;
  o.x = -cut2 * over * c.g[0];
  o.y = -cut2 * over * c.g[1];
  o.xx = c.xx * over + more * c.g[0] * c.g[0];
  o.xy = c.xy * over + more * c.g[0] * c.g[1];
  o.yy = c.yy * over + more * c.g[1] * c.g[1];
  // |S| (1 + cut2 g' S^-1 g / w) / w^2, and g' S^-1 g is ahead.ahead less nearness.
  o.determinant = c.determinant * over * over * (1.0f + cut2 * over * (c.ahead - c.nearness));
  return o;
}

// root(v): the square root of v >= 0. cut2: the square of c. A little more than exact, for
// rounding.
template <typename Real, typename Root>
Reach<Real> reachOf(const Conic<Real>& c, Real cut2, const Root& root) {
  constexpr float kMore = 1e-5f;
  const Real past = cut2 * c.ahead - 1.0f;  // -w
  const auto along = [&](Real spread, Real aside, Real g, Real& less, Real& more, Real& mirror) {
    const Real square = spread - (1.0f + kMore) * cut2 * aside;
    const auto ends = square > 0.0f;
    const Real deviation = root(cut2 * (ends ? square : Real{}));
    const auto towards = [&](Real over) {
      const Real reach = (1.0f + kMore) * cut2 * spread / over;
      return ends & (over > 0.0f) & (reach < kUnbounded) ? reach : kUnbounded + Real{};
    };
    less = towards(deviation - cut2 * g);
    more = towards(deviation + cut2 * g);
    const Real beyond = (1.0f - kMore) * (cut2 * g + (g > 0.0f ? deviation : -deviation)) / past;
    const Real end = g > 0.0f ? kUnbounded + Real{} : -kUnbounded + Real{};
    mirror = past > 0.0f ? (ends ? beyond : Real{}) : end;
  };
  Reach<Real> reach;
  along(c.xx, c.aside[0], c.g[0], reach.left, reach.right, reach.mirror_x);
  along(c.yy, c.aside[1], c.g[1], reach.up, reach.down, reach.mirror_y);
  return reach;
}

// Where a disc's spot is, from p. [px]
template <typename Real>
void spotOf(const Conic<Real>& c, Real& x, Real& y) {
  const Real left = 1.0f - c.ahead;
  const Real over = left * left > 1e-6f ? 1.0f / left : Real{};
  x = -over * c.g[0];
  y = -over * c.g[1];
}

}  // namespace rosplat
