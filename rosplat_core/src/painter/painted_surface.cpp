#include "rosplat_core/painter/painted_surface.hpp"

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

namespace rosplat {

namespace {

constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();

}  // namespace

std::vector<double> PaintedSurface::seenBy(const SplatCamera& camera,
                                           const std::vector<std::uint8_t>& rgba,
                                           float least_alpha) const {
  constexpr int kSteps = 3;  // iterations towards the point where the ray meets the surface
  std::vector<double> depths(std::size_t(camera.width) * std::size_t(camera.height), kNothing);
  if (depths_.empty()) return depths;
  // The surface's depth at the pixel of camera_ that shows, or hides, a point in its frame.
  const auto depthOf = [&](const std::array<double, 3>& point) {
    const auto [right, down] = pixelOf(camera_, point);
    const double x = std::floor(right), y = std::floor(down);
    const bool ahead = camera_.orthographic || point[2] > 0;
    const bool inside = ahead && x >= 0 && y >= 0 && x < camera_.width && y < camera_.height;
    if (!inside) return kNothing;
    const std::size_t pixel = std::size_t(y) * std::size_t(camera_.width) + std::size_t(x);
    return rgba[4 * pixel + 3] >= 255 * least_alpha ? double(depths_[pixel]) : kNothing;
  };
  const Placement there = frameIn(camera, camera_), back = frameIn(camera_, camera);
  for (std::size_t pixel = 0; pixel < depths.size(); ++pixel) {
    const double x = double(pixel % std::size_t(camera.width)) + 0.5;
    const double y = double(pixel / std::size_t(camera.width)) + 0.5;
    double& depth = depths[pixel];
    depth = depthOf(pointAt(camera, x, y, 1));  // as if the camera had not moved
    for (int step = 0; step < kSteps && !std::isnan(depth); ++step) {
      const std::array<double, 3> point = there(pointAt(camera, x, y, depth));
      const double met = depthOf(point);
      const double longer = camera_.orthographic ? 1 : met / point[2];
      depth = back({longer * point[0], longer * point[1], met})[2];
    }
  }
  return depths;
}

}  // namespace rosplat
