#pragma once

#include <array>
#include <deque>
#include <utility>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// How a camera moves, in its own frame: a screw. An orbit and a straight flight are screws.
struct CameraMotion {
  std::array<double, 3> turn{};   // axis times angle [rad/s]
  std::array<double, 3> shift{};  // [m/s]

  bool none() const { return *this == CameraMotion{}; }
  bool operator==(const CameraMotion& o) const { return turn == o.turn && shift == o.shift; }
};

// Returns the motion from a camera to another of the same map in a time [s]; none for nearly half a
// turn (3 rad) or more.
CameraMotion motionBetween(const SplatCamera& from, const SplatCamera& to, double seconds);

// Returns the camera after it has moved for a time [s].
SplatCamera moved(const SplatCamera& camera, const CameraMotion& motion, double seconds);

// Finds a camera's motion from its recent poses.
class MotionTracker {
 public:
  // To be called each frame. Returns the camera's motion now [s]; none if the camera rests.
  CameraMotion follow(const SplatCamera& camera, double now);

 private:
  std::deque<std::pair<double, SplatCamera>> seen_;
};

}  // namespace rosplat
