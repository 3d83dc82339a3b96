#pragma once

#include <array>
#include <limits>
#include <utility>

#include "rosplat_core/map/placement.hpp"

namespace rosplat {

// A camera in the map's frame, in double precision so that maps far from their frame's origin stay
// sharp. Optical axes: x right, y down, z forward (REP-103). The top left pixel's centre is at
// (0.5, 0.5). Places the map's frame in the camera's.
struct SplatCamera : Placement {
  bool orthographic = false;
  double fx = 1, fy = 1, cx = 0, cy = 0;  // [px], orthographic fx, fy [px/m]
  int width = 1, height = 1;              // [px]
  double near_clip = 0.01;                // [m]
  double far_clip = std::numeric_limits<float>::max();
  double extent_scale = 1;  // splats are drawn this many times as large
  // If this picture is part of a larger one, as for rviz's mouse tools: the larger one's principal
  // point and size [px of this picture], so that a splat has the same ellipse in both. Else size 0.
  struct Whole {
    double cx = 0, cy = 0, width = 0, height = 0;
  } part_of;
  double rounding = 0;  // rounding error of the position, from the host program's own numbers [m]
  // The scene's depth buffer: ndc.z = (ndc_scale z + ndc_offset) / w; w = z, orthographic w = 1.
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

// Returns the pose of a camera's frame in the frame of another camera of the same map.
inline Placement frameIn(const SplatCamera& camera, const SplatCamera& other) {
  return other * camera.inverse();
}

// For one camera given in the frames of two maps: returns the pose of the first map in the second.
inline Placement frameSeenBy(const SplatCamera& camera, const SplatCamera& other) {
  return other.inverse() * camera;
}

// The point of a camera's frame that its picture shows at x, y [px] in a depth [m].
std::array<double, 3> pointAt(const SplatCamera& camera, double x, double y, double depth);
// Where a camera's picture shows a point of the camera's frame: x, y [px].
std::array<double, 2> pixelOf(const SplatCamera& camera, const std::array<double, 3>& point);

// Returns a scene's camera in the frame of a map that is placed in the scene.
SplatCamera inFrameOf(const Placement& map, const SplatCamera& camera);

// Returns a camera's position relative to a map's origin [m]. In double precision, so that 32-bit
// floats never hold either one's distance from zero.
std::array<double, 3> eyeOf(const SplatCamera& camera, const std::array<double, 3>& origin);

// Returns ndc_scale and ndc_offset of a depth buffer between two distances [m].
std::pair<double, double> depthBuffer(bool orthographic, double near_clip, double far_clip);
// Returns the far distance of the depth buffer that hides splats behind opaque objects [m].
double depthRange(double near_clip, double far_clip);

// Returns the camera whose optical frame has this pose in the map's frame: position [m], quaternion
// x y z w of any length but zero. Throws std::invalid_argument, naming the field, for a camera that
// can't see, or whose matrices don't fit 32-bit floats.
SplatCamera makeCamera(const std::array<double, 3>& position,
                       const std::array<double, 4>& orientation, bool orthographic, double fx,
                       double fy, double cx, double cy, double width, double height,
                       double near_clip, double far_clip);

// Returns the camera of a rectangle of a camera's picture [px].
SplatCamera crop(const SplatCamera& camera, int left, int top, int width, int height);

// Makes a camera's picture a part of another's, at any resolution. Returns false if the cameras'
// poses or kinds of projection differ.
bool makePart(SplatCamera& camera, const SplatCamera& of);

}  // namespace rosplat
