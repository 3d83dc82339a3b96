#include "rosplat_core/painter/depth_warp.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace rosplat {

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

}  // namespace rosplat
