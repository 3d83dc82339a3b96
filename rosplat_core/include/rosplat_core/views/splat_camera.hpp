#pragma once

#include <array>
#include <limits>
#include <utility>

#include "rosplat_core/map/placement.hpp"

namespace rosplat {

// A camera in the map's frame, in double precision so that maps far from their frame's origin stay
// sharp. Optical axes: x right, y down, z forward (REP-103). Pixels: the top left one's centre is
// at (0.5, 0.5).
struct SplatCamera {
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  // map -> camera, rows
  std::array<double, 3> translation{};                        // map -> camera [m]
  bool orthographic = false;
  double fx = 1, fy = 1, cx = 0, cy = 0;  // [px], orthographic fx, fy [px/m]
  int width = 1, height = 1;              // [px]
  double near_clip = 0.01;                // [m]
  double far_clip = std::numeric_limits<float>::max();
  double extent_scale = 1;  // splats are drawn this many times as large
  // Where this picture is a part of one, as for rviz's mouse tools: that one's principal point and
  // size in pixels of this, so that a splat has the same ellipse in both. Else of size 0.
  struct Whole {
    double cx = 0, cy = 0, width = 0, height = 0;
  } part_of;
  double rounding = 0;  // of where the host's own numbers put it [m]
  // How the scene's depth buffer sees it: ndc.z = (ndc_scale z + ndc_offset) / w, w = z or 1.
  double ndc_scale = 0, ndc_offset = 0;

  Whole whole() const {
    return part_of.width > 0 ? part_of : Whole{cx, cy, double(width), double(height)};
  }

  bool operator==(const SplatCamera& o) const {
    return rotation == o.rotation && translation == o.translation &&
           orthographic == o.orthographic && fx == o.fx && fy == o.fy && cx == o.cx && cy == o.cy &&
           width == o.width && height == o.height && near_clip == o.near_clip &&
           far_clip == o.far_clip && extent_scale == o.extent_scale;
  }
};

// Where a camera's frame is in that of another of the same map.
Placement frameIn(const SplatCamera& camera, const SplatCamera& other);

// Where the map of a camera is in that of another, which are one camera.
Placement frameSeenBy(const SplatCamera& camera, const SplatCamera& other);

// A camera of a scene, as one in the frame of a map that is placed there.
SplatCamera inFrameOf(const Placement& map, const SplatCamera& camera);

// Where a camera is, relative to a map's origin: in double precision, so that neither's distance
// from zero reaches 32-bit floats. [m]
std::array<double, 3> eyeOf(const SplatCamera& camera, const std::array<double, 3>& origin);

// How a depth buffer between two distances [m] sees a camera: ndc_scale and ndc_offset.
std::pair<double, double> depthBuffer(bool orthographic, double near_clip, double far_clip);
// The farther one of the depth buffer that hides splats behind opaque objects. [m]
double depthRange(double near_clip, double far_clip);

// A camera at the pose of its optical frame in the map's frame: position [m], quaternion x y z w of
// any length but zero. Throws std::invalid_argument, naming the field, for a camera that can't see,
// or whose matrices are none of 32-bit floats.
SplatCamera makeCamera(const std::array<double, 3>& position,
                       const std::array<double, 4>& orientation, bool orthographic, double fx,
                       double fy, double cx, double cy, double width, double height,
                       double near_clip, double far_clip);

// A rectangle of a camera's picture. [px]
SplatCamera crop(const SplatCamera& camera, int left, int top, int width, int height);

// Makes a camera a part of another's picture, at whatever resolution; false where it isn't: where
// they look from elsewhere, or elsewhere to.
bool makePart(SplatCamera& camera, const SplatCamera& of);

}  // namespace rosplat
