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

// Reads "full", an error in pixels ("1.5px"), a most of splats ("800000", "800k", "2M") or a frame
// time ("40ms"). Throws std::invalid_argument, naming what it can't read.
Detail parseDetail(const std::string& text);

std::string toText(const Detail& detail);

// What the time of pictures is made of: that of their splats, and what goes with pixels.
class PictureTime {
 public:
  // Of the last picture.
  void took(double drawn, double seconds);
  // How many splats one may draw that takes so long; but not so few that fewer are hardly faster,
  // and at least a quarter of the last one's.
  double splatsIn(double seconds) const;

 private:
  struct Picture {
    double drawn = 0, seconds = 0;
  };
  Picture last_, before_;  // the latter drew far more, or far fewer
  double others_ = 0;      // what doesn't go with splats, as two pictures tell [s]
};

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
  // The time that one took, which may be known later.
  void took(double error, double seconds);
  // Of a picture of all splats, whatever was chosen. [s]
  void drewAll(double seconds) { seconds_in_full_ = seconds; }
  double secondsInFull() const { return seconds_in_full_; }  // 0 before any
  // Whether levels are needed for it: a frame time may have room for all.
  bool needsLevels(const Detail& detail) const {
    if (detail.kind != Detail::Kind::kTime) return detail.kind != Detail::Kind::kFull;
    return seconds_ > 0 || seconds_in_full_ > detail.amount;
  }
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
  std::optional<double> error_;           // of the last picture [px]
  double timed_error_ = 0, seconds_ = 0;  // of the last one of which it is known
  PictureTime time_;
  double seconds_in_full_ = 0;
  bool settled_ = true;
  std::string problem_;
};

}  // namespace rosplat
