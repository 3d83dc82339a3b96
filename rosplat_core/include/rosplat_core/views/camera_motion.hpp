#pragma once

#include <array>
#include <deque>
#include <utility>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// How a camera moves, in its own frame: a screw, which is what an orbit and a straight flight are.
struct CameraMotion {
  std::array<double, 3> turn{};   // axis times angle [rad/s]
  std::array<double, 3> shift{};  // [m/s]

  bool none() const { return *this == CameraMotion{}; }
  bool operator==(const CameraMotion& o) const { return turn == o.turn && shift == o.shift; }
};

// What takes a camera to another of the same map in so long [s]; none where that is half a turn.
CameraMotion motionBetween(const SplatCamera& from, const SplatCamera& to, double seconds);

// Where a camera is that has moved for so long. [s]
SplatCamera moved(const SplatCamera& camera, const CameraMotion& motion, double seconds);

// Finds how a camera moves by where it was of late.
class MotionTracker {
 public:
  // Of a camera as it is now [s]; none where it rests.
  CameraMotion follow(const SplatCamera& camera, double now);

 private:
  std::deque<std::pair<double, SplatCamera>> seen_;
};

}  // namespace rosplat
