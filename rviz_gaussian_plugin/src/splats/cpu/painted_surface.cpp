#include "cpu/painted_surface.hpp"

#include <cmath>
#include <cstddef>
#include <limits>

namespace rosplat {

namespace {

constexpr float kSurfaceAlpha = 0.5f;
constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();

// What a camera sees at a place in its picture, so deep, in its frame.
std::array<double, 3> pointAt(const SplatCamera& camera, double x, double y, double depth) {
  const double spread = camera.orthographic ? 1 : depth;
  return {spread * (x - camera.cx) / camera.fx, spread * (y - camera.cy) / camera.fy, depth};
}

}  // namespace

PaintedSurface::PaintedSurface(const SplatCamera& camera, const SplatPicture& picture)
    : camera_(camera), depths_(picture.depth.size()) {
  for (std::size_t i = 0; i < depths_.size(); ++i) {
    const float alpha = picture.colour[4 * i + 3], depth = picture.depth[i];
    depths_[i] = alpha >= kSurfaceAlpha ? depth : static_cast<float>(kNothing);
  }
}

double PaintedSurface::depthOf(const std::array<double, 3>& point) const {
  const double spread = camera_.orthographic ? 1 : point[2];
  const double x = std::floor(camera_.fx * point[0] / spread + camera_.cx);
  const double y = std::floor(camera_.fy * point[1] / spread + camera_.cy);
  const bool inside = spread > 0 && x >= 0 && y >= 0 && x < camera_.width && y < camera_.height;
  return inside ? depths_[std::size_t(y) * std::size_t(camera_.width) + std::size_t(x)] : kNothing;
}

double PaintedSurface::depthAt(const SplatCamera& camera, int column, int row) const {
  constexpr int kSteps = 3;  // towards where the ray meets the surface
  if (depths_.empty()) return kNothing;
  const double x = column + 0.5, y = row + 0.5;
  const Placement there = frameIn(camera, camera_), back = frameIn(camera_, camera);
  double depth = depthOf(pointAt(camera, x, y, 1));  // as if the camera had not moved
  for (int step = 0; step < kSteps && !std::isnan(depth); ++step) {
    std::array<double, 3> point = there(pointAt(camera, x, y, depth));
    const double met = depthOf(point);
    const double longer = camera_.orthographic ? 1 : met / point[2];
    depth = back({longer * point[0], longer * point[1], met})[2];
  }
  return depth;
}

}  // namespace rosplat
