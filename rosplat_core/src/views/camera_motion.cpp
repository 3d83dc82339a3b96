#include "rosplat_core/views/camera_motion.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace rosplat {

namespace {

using Vector = std::array<double, 3>;

// Motion is measured over this time [s], as a mouse's moves don't come in step with frames.
constexpr double kOfLate = 0.1;
// A camera rests after so many equal frames: a mouse that turns round stands still for one frame.
constexpr std::size_t kResting = 3;

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// v + a w x v + b w x (w x v)
Vector screw(const Vector& w, const Vector& v, double a, double b) {
  const Vector once = cross(w, v), twice = cross(w, once);
  return {v[0] + a * once[0] + b * twice[0], v[1] + a * once[1] + b * twice[1],
          v[2] + a * once[2] + b * twice[2]};
}

}  // namespace

// Logarithm and exponential of SE(3); Sola, Deray and Atchuthan 2018, 174 and 176.
CameraMotion motionBetween(const SplatCamera& from, const SplatCamera& to, double seconds) {
  const auto [r, t] = frameIn(from, to);
  Vector w{0.5 * (r[7] - r[5]), 0.5 * (r[2] - r[6]), 0.5 * (r[3] - r[1])};
  const double sine = std::hypot(w[0], w[1], w[2]), cosine = 0.5 * (r[0] + r[4] + r[8] - 1);
  const double angle = std::atan2(sine, cosine);
  constexpr double kSmall = 1e-6, kMost = 3.0;
  if (!(angle < kMost)) return {};
  double b = 1.0 / 12;
  if (angle > kSmall) {
    for (double& part : w) part *= angle / sine;
    b = 1 / (angle * angle) - (1 + cosine) / (2 * angle * sine);
  }
  CameraMotion motion{w, screw(w, t, -0.5, b)};
  for (double& part : motion.turn) part /= seconds;
  for (double& part : motion.shift) part /= seconds;
  return motion;
}

SplatCamera moved(const SplatCamera& camera, const CameraMotion& motion, double seconds) {
  Vector w = motion.turn, v = motion.shift;
  for (double& part : w) part *= seconds;
  for (double& part : v) part *= seconds;
  const double angle = std::hypot(w[0], w[1], w[2]);
  // sin(a) / a, (1 - cos(a)) / a^2 and (a - sin(a)) / a^3, for a small angle at first.
  double sine = 1, cosine = 0.5, rest = 1.0 / 6;
  if (constexpr double kSmall = 1e-4; angle > kSmall) {
    sine = std::sin(angle) / angle;
    cosine = (1 - std::cos(angle)) / (angle * angle);
    rest = (1 - sine) / (angle * angle);
  }
  SplatCamera there = camera;
  for (std::size_t column = 0; column < 3; ++column) {
    const Vector axis{camera.rotation[column], camera.rotation[3 + column],
                      camera.rotation[6 + column]};
    const Vector turned = screw(w, axis, sine, cosine);
    for (std::size_t row = 0; row < 3; ++row) there.rotation[3 * row + column] = turned[row];
  }
  const Vector turned = screw(w, camera.translation, sine, cosine);
  const Vector shift = screw(w, v, cosine, rest);
  for (std::size_t i = 0; i < 3; ++i) there.translation[i] = turned[i] + shift[i];
  return there;
}

CameraMotion MotionTracker::follow(const SplatCamera& camera, double now) {
  seen_.emplace_back(now, camera);
  while (seen_.size() > kResting && seen_[1].first <= now - kOfLate) seen_.pop_front();
  const auto lately = seen_.end() - std::ptrdiff_t(std::min(seen_.size(), kResting));
  const bool rests = std::all_of(lately, seen_.end(),
                                 [&camera](const auto& seen) { return seen.second == camera; });
  const auto& [then, before] = seen_.front();
  return rests || !(now > then) ? CameraMotion{} : motionBetween(before, camera, now - then);
}

}  // namespace rosplat
