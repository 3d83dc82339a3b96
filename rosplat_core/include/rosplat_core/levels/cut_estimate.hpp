#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Where nothing is left to be merged. [px]
constexpr double kCoarsestError = 1e15;

// How many splats and nodes a view draws, by the error that is allowed: by samples.
class CutEstimate {
 public:
  CutEstimate() = default;
  // groups: where those of the levels are, by index; blends: whether levels do.
  CutEstimate(const std::vector<LevelSamples>& levels, const SplatCamera& camera,
              const std::vector<Group>& groups, const ClipBox& box, bool blends);

  double drawn(double error) const;
  // The least error at which no more are drawn: 0 where it is all of them.
  double errorFor(double splats) const;

 private:
  static constexpr std::size_t kBins = 960;

  std::array<double, kBins + 1> drawn_{};  // by the errors at which bins begin
};

}  // namespace rosplat
