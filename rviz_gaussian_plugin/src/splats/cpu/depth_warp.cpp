#include "cpu/depth_warp.hpp"

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
  const auto width = static_cast<std::size_t>(other.width);
  for (std::size_t pixel = 0; pixel < depths.size(); ++pixel) {
    if (!(depths[pixel] < 1)) continue;
    const double ndc = 2.0 * double(depths[pixel]) - 1;
    const double depth = camera.orthographic ? (ndc - camera.ndc_offset) / camera.ndc_scale
                                             : camera.ndc_offset / (ndc - camera.ndc_scale);
    const double spread = camera.orthographic ? 1 : depth;
    const std::array<double, 3> point =
        there({spread * (double(pixel % width) + 0.5 - camera.cx) / camera.fx,
               spread * (double(pixel / width) + 0.5 - camera.cy) / camera.fy, depth});
    const double w = other.orthographic ? 1 : point[2];
    const double x = std::floor(other.fx * point[0] / w + other.cx);
    const double y = std::floor(other.fy * point[1] / w + other.cy);
    if (!(w > 0 && x >= 0 && y >= 0 && x < other.width && y < other.height)) continue;
    const double seen = 0.5 * (other.ndc_scale * point[2] + other.ndc_offset) / w + 0.5;
    float& nearest = warped[std::size_t(y) * width + std::size_t(x)];
    nearest = std::min(nearest, static_cast<float>(std::max(seen, 0.0)));
  }
  // What has come nearer is spread out.
  const auto close = [&](std::size_t step, std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const float before = warped[i - step], after = warped[i + step];
      if (warped[i] == 1 && before < 1 && after < 1) warped[i] = std::max(before, after);
    }
  };
  for (std::size_t row = 0; row < warped.size(); row += width) close(1, row + 1, row + width - 1);
  if (warped.size() > 2 * width) close(width, width, warped.size() - width);
  return warped;
}

}  // namespace rosplat
