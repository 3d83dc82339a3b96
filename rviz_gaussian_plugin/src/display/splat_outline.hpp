#pragma once

#include <OgreAxisAlignedBox.h>
#include <OgreMatrix4.h>
#include <OgreVector.h>

#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// A splat's ellipsoid of `sigmas` standard deviations, as its three principal sections: pairs of
// line ends in the map's frame. [m]
std::vector<Ogre::Vector3> outline(const SplatValues& splat, float sigmas);

// The box about that ellipsoid along the axes of a frame in which the map has the pose `map`. [m]
Ogre::AxisAlignedBox boxAround(const SplatValues& splat, float sigmas, const Ogre::Affine3& map);

}  // namespace rosplat
