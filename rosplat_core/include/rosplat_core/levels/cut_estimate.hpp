#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// An error at which nothing is left to be merged. [px]
constexpr double kCoarsestError = 1e15;

// Estimates from samples how many splats and nodes a view draws at each allowed error.
class CutEstimate {
 public:
  // levels, groups: of the map, by group index.
  CutEstimate(const std::vector<LevelSamples>& levels, const SplatCamera& camera,
              const std::vector<Group>& groups, const RenderSettings& settings);

  double drawn(double error) const;
  // The least error [px] that draws no more than `splats`: 0 for all, kCoarsestError if none does.
  double errorFor(double splats) const;

 private:
  static constexpr std::size_t kBins = 960;

  std::array<double, kBins + 1> drawn_{};  // at the errors at which bins begin
};

}  // namespace rosplat
