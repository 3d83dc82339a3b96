#include "rosplat_core/views/splat_camera.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace rosplat {

std::array<double, 3> pointAt(const SplatCamera& camera, double x, double y, double depth) {
  const double spread = camera.orthographic ? 1 : depth;
  return {spread * (x - camera.cx) / camera.fx, spread * (y - camera.cy) / camera.fy, depth};
}

std::array<double, 2> pixelOf(const SplatCamera& camera, const std::array<double, 3>& point) {
  const double w = camera.orthographic ? 1 : point[2];
  return {camera.fx * point[0] / w + camera.cx, camera.fy * point[1] / w + camera.cy};
}

SplatCamera inFrameOf(const Placement& map, const SplatCamera& camera) {
  SplatCamera moved = camera;
  static_cast<Placement&>(moved) = camera * map;
  return moved;
}

std::array<double, 3> eyeOf(const SplatCamera& camera, const std::array<double, 3>& origin) {
  return Placement{camera.rotation, camera(origin)}.inverse().translation;
}

std::pair<double, double> depthBuffer(bool orthographic, double near_clip, double far_clip) {
  const double range = far_clip - near_clip, sum = far_clip + near_clip;
  return orthographic ? std::pair(2 / range, -sum / range)
                      : std::pair(sum / range, -2 * far_clip * near_clip / range);
}

double depthRange(double near_clip, double far_clip) { return std::min(far_clip, near_clip + 1e4); }

SplatCamera makeCamera(const std::array<double, 3>& position,
                       const std::array<double, 4>& orientation, bool orthographic, double fx,
                       double fy, double cx, double cy, double width, double height,
                       double near_clip, double far_clip) {
  constexpr double kLongestSide = 16384, kMostPixels = 1 << 25;  // 512 MiB of float colours
  // Limits of a projection matrix's elements: products of four, and the inverse, fit 32-bit floats.
  constexpr double kLeast = 1e-9, kMost = 1e9;
  constexpr double kFarthest = 1e18;  // the square fits a 32-bit float [m]
  const auto isMost = [](double x, double most) { return std::fabs(x) <= most; };  // false for NaN
  const auto isElement = [&](double x) { return x >= kLeast && x <= kMost; };
  const auto& [x, y, z, w] = orientation;
  const double norm = x * x + y * y + z * z + w * w;
  const auto check = [](bool good, const char* fault) {
    if (!good) throw std::invalid_argument(fault);
  };
  for (const double p : position) {
    check(isMost(p, kFarthest), "pose.position is not finite, or too far away for 32-bit floats");
  }
  check(std::isnormal(norm), "pose.orientation is no rotation");
  check(fx > 0 && fy > 0 && std::isfinite(fx + fy + cx + cy), "fx, fy, cx, cy are no intrinsics");
  check(width >= 1 && height >= 1 && width <= kLongestSide && height <= kLongestSide &&
            width * height <= kMostPixels,
        "width and height must be 1 to 16384, and 2^25 pixels at most");
  check(isElement(2 * fx / width), "fx is too small or too large for 32-bit floats");
  check(isElement(2 * fy / height), "fy is too small or too large for 32-bit floats");
  check(isMost(2 * cx / width, kMost), "cx is too far away for 32-bit floats");
  check(isMost(2 * cy / height, kMost), "cy is too far away for 32-bit floats");
  check(near_clip < far_clip && (orthographic || near_clip > 0),
        "near_clip and far_clip are no range of depths");
  check(orthographic ? isMost(near_clip, kMost) : isElement(near_clip),
        "near_clip is too small or too large for 32-bit floats");
  const double scale = depthBuffer(orthographic, near_clip, depthRange(near_clip, far_clip)).first;
  check(static_cast<float>(near_clip) < static_cast<float>(far_clip) && isMost(scale, kMost),
        "near_clip and far_clip are no range of depths to 32-bit floats");

  SplatCamera camera;
  static_cast<Placement&>(camera) = makePlacement(position, orientation).inverse();
  camera.orthographic = orthographic;
  camera.fx = fx;
  camera.fy = fy;
  camera.cx = cx;
  camera.cy = cy;
  camera.width = static_cast<int>(width);
  camera.height = static_cast<int>(height);
  camera.near_clip = near_clip;
  camera.far_clip = std::min(far_clip, double(std::numeric_limits<float>::max()));
  return camera;
}

SplatCamera crop(const SplatCamera& camera, int left, int top, int width, int height) {
  SplatCamera part = camera;
  part.cx -= left;
  part.cy -= top;
  part.width = width;
  part.height = height;
  part.part_of = camera.whole();
  return part;
}

bool makePart(SplatCamera& camera, const SplatCamera& of) {
  constexpr double kSame = 1e-4;
  if (camera.orthographic != of.orthographic) return false;
  for (std::size_t i = 0; i < 9; ++i) {
    if (!(std::fabs(camera.rotation[i] - of.rotation[i]) < kSame)) return false;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const double near = kSame * (1 + std::fabs(of.translation[i]));
    if (!(std::fabs(camera.translation[i] - of.translation[i]) < near)) return false;
  }
  const double x = camera.fx / of.fx, y = camera.fy / of.fy;
  camera.part_of = {x * of.cx, y * of.cy, x * of.width, y * of.height};
  return true;
}

}  // namespace rosplat
