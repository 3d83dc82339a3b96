#include "rosplat_core/painter/depth_warp.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

namespace rosplat {

namespace {

constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();

}  // namespace

std::vector<float> warpDepths(const std::vector<float>& depths, const SplatCamera& camera,
                              const SplatCamera& other) {
  std::vector<float> warped(depths.size(), 1.0f);
  if (depths.empty()) return warped;
  const Placement there = frameIn(camera, other);
  const int width = other.width, height = other.height;
  int left = width, right = -1, top = height, bottom = -1;  // box around the moved pixels
  for (int row = 0; row < height; ++row) {
    const float* const in_row = &depths[std::size_t(row) * std::size_t(width)];
    if (!std::count_if(in_row, in_row + width, [](float depth) { return depth < 1; })) continue;
    for (int column = 0; column < width; ++column) {
      if (!(in_row[column] < 1)) continue;
      const double ndc = 2.0 * double(in_row[column]) - 1;
      const double depth = camera.orthographic ? (ndc - camera.ndc_offset) / camera.ndc_scale
                                               : camera.ndc_offset / (ndc - camera.ndc_scale);
      const auto point = there(pointAt(camera, column + 0.5, row + 0.5, depth));
      const auto [right_of, below] = pixelOf(other, point);
      const double w = other.orthographic ? 1 : point[2];
      const double x = std::floor(right_of), y = std::floor(below);
      if (!(w > 0 && x >= 0 && y >= 0 && x < width && y < height)) continue;
      const double seen = 0.5 * (other.ndc_scale * point[2] + other.ndc_offset) / w + 0.5;
      left = std::min(left, int(x)), right = std::max(right, int(x));
      top = std::min(top, int(y)), bottom = std::max(bottom, int(y));
      float& nearest = warped[std::size_t(y) * std::size_t(width) + std::size_t(x)];
      nearest = std::min(nearest, static_cast<float>(std::max(seen, 0.0)));
    }
  }
  // A camera that comes nearer spreads pixels out: close gaps in rows, then in columns.
  const auto close = [&](int step, int aside, int above) {
    for (int row = top + above; row <= bottom - above; ++row) {
      float* const in_row = &warped[std::size_t(row) * std::size_t(width)];
      for (int column = left + aside; column <= right - aside; ++column) {
        float& depth = in_row[column];
        const float before = in_row[column - step], after = in_row[column + step];
        if (depth == 1 && before < 1 && after < 1) depth = std::max(before, after);
      }
    }
  };
  close(1, 1, 0);
  close(width, 0, 1);
  return warped;
}

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
