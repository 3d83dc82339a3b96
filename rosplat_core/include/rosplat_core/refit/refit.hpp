#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/slots/splats.hpp"
#include "rosplat_core/threads/thread_team.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// About how far one step moves a splat's values at most.
struct RefitRates {
  float position = 0;  // in units of the splat's own size
  float scale = 0;     // of the logarithms
  float rotation = 0;  // of the unit quaternion
  float opacity = 0;   // of the logit
  float colour = 0;    // of the coefficient of band 0
  float bands = 0;     // of the coefficients of the other bands
};

// Fits splats to pictures of them: each step draws one picture, and moves the splats seen in it
// against the gradient of its mean squared error (Kerbl et al. 2023, Adam of Kingma and Ba 2015).
// The gradient by the position leaves out that colours change with the direction of view.
class Refit {
 public:
  // Throws std::invalid_argument as SplatsView::check() does, and if a splat has a value that isn't
  // finite, a negative scale or a quaternion of zero.
  Refit(const SplatsView& start, std::shared_ptr<ThreadTeam> team,
        CpuRasterizer::Instructions instructions = CpuRasterizer::Instructions::kBest);
  ~Refit();

  // Makes a step towards a picture over black: RGB of 0 to 1, rows of the camera's width. Returns
  // the mean squared error before the step.
  double step(const SplatCamera& camera, const float* target, const RefitRates& rates);

  // Returns the mean squared error; gradient: values() numbers a splat.
  double gradientAt(const SplatCamera& camera, const float* target, std::vector<float>& gradient);

  // How many values a splat has, as trainers keep them: position [m], logarithms of scales,
  // quaternion x y z w, logit of the opacity, harmonics.
  std::size_t values() const { return values_; }

  Splats splats() const;

 private:
  struct Drawing;
  struct Seen;
  struct Work;

  double draw(const Drawing& view, const float* target);
  // Draws, and calls use(index, gradient) for each splat that is seen, side by side.
  template <typename Use>
  double forEachSeen(const SplatCamera& camera, const float* target, const Use& use);

  std::shared_ptr<ThreadTeam> team_;
  int sh_degree_;
  bool antialiased_;
  std::array<double, 3> origin_;
  std::size_t count_, values_;
  std::vector<float> now_, mean_, square_;  // values() a splat: as they are, and Adam's moments
  std::vector<std::uint16_t> steps_;        // that each splat has made
  std::unique_ptr<Work> work_;              // of the picture that is drawn
};

}  // namespace rosplat
