#pragma once

#include <OgreAxisAlignedBox.h>
#include <OgreMatrix4.h>
#include <OgreVector.h>

#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// The ellipsoid of so many standard deviations about a splat, as its three principal sections:
// pairs of ends of lines, in the map's frame. [m]
std::vector<Ogre::Vector3> outline(const SplatValues& splat, float sigmas);

// The box about that ellipsoid along the axes of a frame, given the map's pose in it. [m]
Ogre::AxisAlignedBox boxAround(const SplatValues& splat, float sigmas, const Ogre::Affine3& map);

}  // namespace rosplat
