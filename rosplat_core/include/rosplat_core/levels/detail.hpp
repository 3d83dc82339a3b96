#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "rosplat_core/levels/cut_estimate.hpp"
#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Reads "full", an error in pixels ("1.5px") or a most of splats ("800000", "800k", "2M"). Throws
// std::invalid_argument, naming what it can't read.
Detail parseDetail(const std::string& text);

std::string toText(const Detail& detail);

// Chooses the error of a view's pictures, one after the other.
class DetailControl {
 public:
  // For the next picture [px]; 0 has all drawn in full, as where an error draws about as many:
  // levels that blend may be more. Of a picture that is waited for, whatever the last one had;
  // otherwise it moves towards what is asked for, so that nobody sees it move.
  double choose(const RenderSettings& settings, const std::vector<LevelSamples>& levels,
                const SplatCamera& camera, const std::vector<Group>& groups);
  // What became of it: how many splats and nodes are in the picture. If that missed a budget that
  // is to be kept at once: the error to which it has to be drawn again.
  std::optional<double> drew(double error, std::size_t drawn);
  // Why the last picture isn't in the detail that was asked for: a budget may be less than there is
  // to be merged to. Empty where it is.
  const std::string& problem() const { return problem_; }
  // Whether it is where it is going.
  bool settled() const { return settled_; }

 private:
  // Of an error that keeps a budget.
  struct Search {
    CutEstimate expected;
    double most;  // splats
    bool at_once;
    double fine = 0;                 // so far the largest error at which too many were drawn
    std::optional<double> coarse{};  // and the least at which few enough
    int narrowed = 0;                // pictures that came between them
  };

  double errorForBudget() const;

  std::optional<Search> search_;  // while a budget is to be kept
  // What hides others is found by drawing, and estimates err: in the last picture.
  double drawn_of_expected_ = 1;
  std::optional<double> error_;  // of the last picture [px]
  bool settled_ = true;
  std::string problem_;
};

}  // namespace rosplat
