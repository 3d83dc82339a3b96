// views/conic.hpp against the distance of a line from a point, in the splat's own frame.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include "rosplat_core/views/conic.hpp"

using namespace rosplat;

namespace {

using Vector = std::array<double, 3>;

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// A splat in front of a camera of one focal length.
struct Seen {
  Vector mean, scales;
  std::array<Vector, 3> axes;
  double focal = 200;

  Vector rayTo(double dx, double dy) const {
    return {mean[0] / mean[2] + dx / focal, mean[1] / mean[2] + dy / focal, 1};
  }
  // Squared, in standard deviations; and the depth where the ray is nearest.
  std::array<double, 2> distance(double dx, double dy) const {
    const Vector ray = rayTo(dx, dy);
    Vector along, middle;  // in the frame in which the splat is a unit ball
    for (std::size_t i = 0; i < 3; ++i) {
      along[i] = dot(axes[i], ray) / scales[i];
      middle[i] = dot(axes[i], mean) / scales[i];
    }
    const Vector area = cross(middle, along);
    return {dot(area, area) / dot(along, along), dot(along, middle) / dot(along, along)};
  }
  template <typename Real>
  Conic<Real> conic() const {
    Rows<Real> rows;
    for (std::size_t i = 0; i < 3; ++i) {
      const double z = mean[2], step = scales[i];
      rows.right[i] = Real(step * focal / z * (axes[i][0] - mean[0] / z * axes[i][2]));
      rows.down[i] = Real(step * focal / z * (axes[i][1] - mean[1] / z * axes[i][2]));
      rows.ahead[i] = Real(step * axes[i][2] / z);
    }
    return conicOf(rows);
  }
};

Seen randomSplat(std::mt19937& random, bool flat) {
  std::normal_distribution<double> normal;
  Seen seen;
  seen.mean = {normal(random), normal(random), 1 + 2 * std::fabs(normal(random))};
  Vector a{normal(random), normal(random), normal(random)};
  Vector b = cross(a, {normal(random), normal(random), normal(random)});
  const auto unit = [](Vector v) {
    const double length = std::sqrt(dot(v, v));
    return Vector{v[0] / length, v[1] / length, v[2] / length};
  };
  a = unit(a), b = unit(b);
  seen.axes = {a, b, cross(a, b)};
  for (double& scale : seen.scales) scale = 0.1 * std::exp(normal(random));
  if (flat) seen.scales[2] = 1e-9;
  return seen;
}

template <typename Real>
std::array<double, 2> distanceOf(const Conic<Real>& c, double dx, double dy) {
  const double flat =
      (c.yy * dx * dx - 2 * c.xy * dx * dy + c.xx * dy * dy) / double(c.determinant);
  const double along = 1 + c.tilt[0] * dx + c.tilt[1] * dy;
  const double over = 1 / (along * along + c.nearness * flat);
  return {flat * over, along * over};
}

}  // namespace

TEST(Conic, IsTheDistanceOfARayFromTheMean) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> offset(-80, 80);
  for (int i = 0; i < 2000; ++i) {
    const Seen seen = randomSplat(random, i % 2);
    const Conic<double> exact = seen.conic<double>();
    const Conic<float> rounded = seen.conic<float>();
    for (int k = 0; k < 20; ++k) {
      const double dx = offset(random), dy = offset(random);
      const auto [expected, depth] = seen.distance(dx, dy);
      if (!(expected < 12)) continue;  // beyond any outline
      EXPECT_NEAR(distanceOf(exact, dx, dy)[0], expected, 1e-6 * (1 + expected));
      EXPECT_NEAR(seen.mean[2] * distanceOf(exact, dx, dy)[1], depth, 1e-6 * std::fabs(depth));
      EXPECT_NEAR(distanceOf(rounded, dx, dy)[0], expected, 2e-3 * (1 + expected));
    }
  }
}

TEST(Conic, OutlineIsWhereTheDistanceIsTheCut) {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> turn(0, 6.283185307), cut(0.1, 11);
  int closed = 0;
  for (int i = 0; i < 2000; ++i) {
    const Seen seen = randomSplat(random, i % 2);
    const Conic<double> conic = seen.conic<double>();
    const double cut2 = cut(random);
    const Outline<double> o = outlineOf(conic, cut2);
    if (o.w < kLeastAhead) continue;
    ++closed;
    EXPECT_NEAR(o.determinant, o.xx * o.yy - o.xy * o.xy, 1e-6 * o.xx * o.yy);
    // Cholesky: a point of the ellipse for each angle.
    const double a = std::sqrt(o.xx), b = o.xy / a, c = std::sqrt(o.determinant) / a;
    for (int k = 0; k < 20; ++k) {
      const double angle = turn(random), r = std::sqrt(cut2);
      const double x = r * std::cos(angle), y = r * std::sin(angle);
      EXPECT_NEAR(seen.distance(o.x + a * x, o.y + b * x + c * y)[0], cut2, 1e-5 * (1 + cut2));
    }
  }
  EXPECT_GT(closed, 1000);
}

TEST(Conic, ReachEndsWhereAPlaneThroughTheCameraTouches) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> cut(0.1, 11);
  std::uniform_real_distribution<double> offset(-2000, 2000);
  int bounded = 0, unbounded = 0, mirrors = 0, behind = 0;
  for (int i = 0; i < 4000; ++i) {
    Seen seen = randomSplat(random, i % 2);
    for (double& scale : seen.scales) scale *= 4;  // many are open
    const double cut2 = cut(random);
    const Conic<double> conic = seen.conic<double>();
    const bool open = outlineOf(conic, cut2).w < 0;
    const auto root = [](auto v) { return std::sqrt(v); };
    const Reach<double> reach = reachOf(conic, cut2, root);
    const Reach<float> rounded = reachOf(seen.conic<float>(), float(cut2), root);
    const auto check = [&](double exact, double of_floats, std::size_t axis, double side) {
      // Of the plane's distance from the mean over the splat's deviation along the plane's normal.
      const auto square = [&](double d) {
        Vector normal = {0, 0, -seen.mean[axis] / seen.mean[2] - side * d / seen.focal};
        normal[axis] = 1;
        double variance = 0;
        for (std::size_t k = 0; k < 3; ++k) {
          variance += std::pow(seen.scales[k] * dot(seen.axes[k], normal), 2);
        }
        return std::pow(dot(normal, seen.mean), 2) / variance;
      };
      if (exact < 1e7) {
        EXPECT_NEAR(square(exact), cut2, 1e-3 * cut2);
        bounded += open;
      } else {
        ++unbounded;
        for (const double d : {1.0, 1e2, 1e4, 1e6}) EXPECT_LT(square(d), 1.001 * cut2);
      }
      EXPECT_GE(of_floats, 0.9999 * std::min(exact, 1e4));
    };
    if (open) {
      const auto mirrored = [&](double mirror, double reach_of, double g) {
        if (mirror == 0) return;
        EXPECT_EQ(mirror > 0, g > 0);
        EXPECT_GE(std::fabs(mirror), 0.99 * reach_of);
        ++mirrors;
      };
      mirrored(reach.mirror_x, conic.g[0] > 0 ? reach.right : reach.left, conic.g[0]);
      mirrored(reach.mirror_y, conic.g[1] > 0 ? reach.down : reach.up, conic.g[1]);
      // Rays beyond are not met behind the camera.
      for (int k = 0; k < 20; ++k) {
        const double dx = offset(random), dy = offset(random);
        const auto [square, depth] = seen.distance(dx, dy);
        if (square > 0.999 * cut2 || depth > 0) continue;
        ++behind;
        const auto within = [](double d, double mirror) {
          return mirror == 0 || (mirror > 0 ? d >= mirror : d <= mirror);
        };
        EXPECT_TRUE(within(dx, reach.mirror_x) && within(dy, reach.mirror_y));
      }
    }
    check(reach.left, rounded.left, 0, -1);
    check(reach.right, rounded.right, 0, 1);
    check(reach.up, rounded.up, 1, -1);
    check(reach.down, rounded.down, 1, 1);
  }
  EXPECT_GT(bounded, 500);
  EXPECT_GT(unbounded, 500);
  EXPECT_GT(mirrors, 500);
  EXPECT_GT(behind, 500);
}
