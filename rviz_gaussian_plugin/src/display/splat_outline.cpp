#include "splat_outline.hpp"

#include <OgreMath.h>
#include <OgreQuaternion.h>

#include <array>

namespace rosplat {

namespace {

constexpr int kSegments = 32;  // lines of a section

Ogre::Vector3 centreOf(const SplatValues& splat) {
  return Ogre::Vector3(Ogre::Real(splat.position[0]), Ogre::Real(splat.position[1]),
                       Ogre::Real(splat.position[2]));
}

// The principal axes, `sigmas` standard deviations long.
std::array<Ogre::Vector3, 3> axesOf(const SplatValues& splat, float sigmas) {
  const auto& [x, y, z, w] = splat.orientation;
  Ogre::Quaternion rotation(w, x, y, z);
  rotation.normalise();
  return {sigmas * splat.scale[0] * rotation.xAxis(), sigmas * splat.scale[1] * rotation.yAxis(),
          sigmas * splat.scale[2] * rotation.zAxis()};
}

}  // namespace

std::vector<Ogre::Vector3> outline(const SplatValues& splat, float sigmas) {
  const Ogre::Vector3 centre = centreOf(splat);
  const auto axes = axesOf(splat, sigmas);
  std::vector<Ogre::Vector3> ends;
  for (std::size_t section = 0; section < 3; ++section) {
    const Ogre::Vector3 &u = axes[section], &v = axes[(section + 1) % 3];
    const auto at = [&](int i) {
      const Ogre::Radian angle(Ogre::Math::TWO_PI * Ogre::Real(i) / kSegments);
      return centre + Ogre::Math::Cos(angle) * u + Ogre::Math::Sin(angle) * v;
    };
    for (int i = 0; i < kSegments; ++i) {
      ends.push_back(at(i));
      ends.push_back(at(i + 1));
    }
  }
  return ends;
}

Ogre::AxisAlignedBox boxAround(const SplatValues& splat, float sigmas, const Ogre::Affine3& map) {
  const Ogre::Vector3 centre = map * centreOf(splat);
  Ogre::Vector3 half = Ogre::Vector3::ZERO;
  for (const Ogre::Vector3& axis : axesOf(splat, sigmas)) {
    const Ogre::Vector3 turned = map.linear() * axis;
    half += turned * turned;
  }
  for (int i = 0; i < 3; ++i) half[i] = Ogre::Math::Sqrt(half[i]);
  return {centre - half, centre + half};
}

}  // namespace rosplat
