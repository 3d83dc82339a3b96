#pragma once

#include <OgreVector.h>

namespace rosplat {

// Where a camera that never rolls looks, z up [rad]: yaw from x about z, pitch downward.
struct Heading {
  float yaw = 0;
  float pitch = 0;

  Ogre::Vector3 forward() const;
  Ogre::Vector3 left() const;
};

// The heading of a camera that looks along a direction; if vertical, `up` decides the yaw.
Heading headingOf(const Ogre::Vector3& direction, const Ogre::Vector3& up);

struct FlyKeys {
  bool forward = false;
  bool back = false;
  bool left = false;
  bool right = false;
  bool up = false;
  bool down = false;
  bool fast = false;
};

constexpr float kFastFactor = 4;

// The velocity that the keys ask for: forward is where the camera looks, up is the world's. [m/s]
Ogre::Vector3 flyVelocity(const FlyKeys& keys, const Heading& heading, float speed);

// A velocity that approaches its target exponentially.
class FlyMotion {
 public:
  // Flies for dt [s] with smoothing as the time constant [s]; returns the way made [m]. Exact while
  // the target stays the same, so the path is the same at any frame rate.
  Ogre::Vector3 advance(const Ogre::Vector3& target, float dt, float smoothing);
  void stop() { velocity_ = Ogre::Vector3::ZERO; }

 private:
  Ogre::Vector3 velocity_ = Ogre::Vector3::ZERO;  // [m/s]
};

}  // namespace rosplat
