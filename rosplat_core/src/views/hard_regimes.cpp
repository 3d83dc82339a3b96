#include "rosplat_core/views/hard_regimes.hpp"

#include <algorithm>
#include <cmath>

#include "rosplat_core/slots/model.hpp"

namespace rosplat {

namespace {

// Rounding moves positions by up to 1/16 standard deviation: 25 to 48 dB ("Far from the origin" in
// docs/stability.md, as the sections quoted below).
constexpr double kCoarseStep = 1.0 / 8;  // between two floats [standard deviations]
// Half of 100 degrees: EWA is 27 dB from exact rays ("Wide fields of view").
constexpr double kWideTangent = 1.1918;
// 15 to 21 dB, but 33 dB with EWA Antialiased ("Zoomed out").
constexpr double kSmall = 0.5;   // standard deviation of a splat [px]
constexpr double kShaken = 0.5;  // rounding error of the viewer's own coordinates [px]

// The distance from a float to the next.
double stepAt(double value) {
  return value == 0 ? 0 : std::ldexp(1.0, std::ilogb(static_cast<float>(value)) - 23);
}

template <typename Predicate>
bool most(const std::vector<SampledSplat>& splats, Predicate holds) {
  const auto count = std::count_if(splats.begin(), splats.end(), holds);
  return 2 * static_cast<std::size_t>(count) > splats.size();
}

bool isCoarse(const SampledSplat& splat) {
  const auto& [x, y, z] = splat.position;
  const double farthest = std::max({std::fabs(x), std::fabs(y), std::fabs(z)});
  return splat.size > 0 && stepAt(farthest) > kCoarseStep * splat.size;
}

bool isWide(const SplatCamera& camera) {
  if (camera.orthographic) return false;
  const double across = std::max(camera.cx, camera.width - camera.cx) / camera.fx;
  const double down = std::max(camera.cy, camera.height - camera.cy) / camera.fy;
  return std::max(across, down) > kWideTangent;
}

// A splat as a camera sees it, or the medians over all that the camera sees.
struct Seen {
  double pixels = 0;  // standard deviation [px], 0 if nothing is seen
  double scale = 0;   // of the picture at the splat [px/m]
};

Seen middleOf(const SplatCamera& camera, const Groups& groups,
              const std::vector<SampledSplat>& splats) {
  std::vector<Seen> seen;
  for (const SampledSplat& splat : splats) {
    const auto& [x, y, z] = splat.position;
    const auto p = camera(groups.all()[splat.group].inMap(std::array<double, 3>{x, y, z}));
    if (!(p[2] > camera.near_clip && p[2] < camera.far_clip)) continue;
    const auto [u, v] = pixelOf(camera, p);
    if (!(u > 0 && v > 0 && u < camera.width && v < camera.height)) continue;
    const double scale = std::max(camera.fx, camera.fy) / (camera.orthographic ? 1 : p[2]);
    seen.push_back({splat.size * scale, scale});
  }
  if (seen.empty()) return {};
  const auto median = [&](double Seen::* figure) {
    const auto middle = seen.begin() + static_cast<std::ptrdiff_t>(seen.size() / 2);
    std::nth_element(seen.begin(), middle, seen.end(),
                     [&](const Seen& a, const Seen& b) { return a.*figure < b.*figure; });
    return (*middle).*figure;
  };
  const double pixels = median(&Seen::pixels);
  return {pixels, median(&Seen::scale)};
}

}  // namespace

std::vector<std::string> hardRegimes(const MapState& map, const MapSample& sample,
                                     const Groups& groups, const RenderSettings& settings,
                                     const std::vector<SplatCamera>& cameras) {
  const std::vector<SampledSplat> splats = sample.splats();
  std::vector<std::string> found;
  if (most(splats, isCoarse)) {
    found.emplace_back(
        "positions are too large for 32-bit floats: publish them relative to an origin");
  }
  if (most(splats, [&](const SampledSplat& splat) {
        return settings.opacity * splat.opacity < kCutoffAlpha;
      })) {
    found.emplace_back("most splats are fainter than 1/255, which isn't drawn");
  }
  const Model model = settings.drawnModel(map.model);
  bool wide = false, small = false, shaken = false;
  for (const SplatCamera& camera : cameras) {
    const Seen seen = middleOf(camera, groups, splats);
    wide = wide || (isEwa(model) && isWide(camera));
    small =
        small || (model == Model::kEwa && seen.pixels > 0 && settings.scale * seen.pixels < kSmall);
    shaken = shaken || seen.scale * camera.rounding > kShaken;
  }
  if (wide) {
    found.emplace_back(
        "beyond 100 degrees of view, large splats lose their shape: set Model to Ray if the map "
        "was "
        "trained along rays");
  }
  if (small) {
    found.emplace_back(
        "most splats in view are smaller than a pixel, which makes them fat: set Model to EWA "
        "Antialiased, or come nearer");
  }
  if (shaken) {
    found.emplace_back(
        "rviz's own coordinates are too large for 32-bit floats: choose a Fixed Frame near by");
  }
  return found;
}

}  // namespace rosplat
