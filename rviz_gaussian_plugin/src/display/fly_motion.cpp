#include "fly_motion.hpp"

#include <cmath>

namespace rosplat {

namespace {

// Slower motion counts as rest, which the exponential never reaches. [m/s]
constexpr float kRest = 1e-4f;

}  // namespace

Ogre::Vector3 Heading::forward() const {
  return {std::cos(yaw) * std::cos(pitch), std::sin(yaw) * std::cos(pitch), -std::sin(pitch)};
}

Ogre::Vector3 Heading::left() const { return {-std::sin(yaw), std::cos(yaw), 0}; }

Heading headingOf(const Ogre::Vector3& direction, const Ogre::Vector3& up) {
  const float level = std::hypot(direction.x, direction.y);
  Heading heading;
  heading.pitch = std::atan2(-direction.z, level);
  const bool vertical = level < 1e-4f * std::abs(direction.z);
  const Ogre::Vector3 ahead = !vertical ? direction : direction.z < 0 ? up : -up;
  heading.yaw = std::atan2(ahead.y, ahead.x);
  return heading;
}

Ogre::Vector3 flyVelocity(const FlyKeys& keys, const Heading& heading, float speed) {
  const auto axis = [](bool plus, bool minus) { return static_cast<float>(plus - minus); };
  const Ogre::Vector3 direction = axis(keys.forward, keys.back) * heading.forward() +
                                  axis(keys.left, keys.right) * heading.left() +
                                  axis(keys.up, keys.down) * Ogre::Vector3::UNIT_Z;
  return (keys.fast ? kFastFactor : 1) * speed * direction.normalisedCopy();
}

Ogre::Vector3 FlyMotion::advance(const Ogre::Vector3& target, float dt, float smoothing) {
  const Ogre::Vector3 lag = velocity_ - target;
  const float kept = smoothing > 0 ? std::exp(-dt / smoothing) : 0;
  velocity_ = target + kept * lag;
  if (target == Ogre::Vector3::ZERO && velocity_.length() < kRest) stop();
  return dt * target + smoothing * (1 - kept) * lag;
}

}  // namespace rosplat
