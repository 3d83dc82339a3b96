#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "rosplat_core/levels/cut_estimate.hpp"
#include "rosplat_core/views/render_settings.hpp"

namespace rosplat {

// Reads "full", an error in pixels ("1.5px") or a budget of splats ("800000", "800k", "2M"). Throws
// std::invalid_argument with the text that can't be read.
Detail parseDetail(const std::string& text);

std::string toText(const Detail& detail);

// Chooses the error for each of a view's pictures in turn.
class DetailControl {
 public:
  // Sets the estimate of what the next picture draws at each error. It is made for that picture's
  // camera or, where pictures are interactive, for the last one's.
  void expect(CutEstimate drawn) { expected_ = drawn; }
  bool expects() const { return expected_.has_value(); }
  // Returns the error for the next picture [px]. 0 draws all in full, in place of an error that
  // would draw about as many: levels that blend may draw even more. If nobody waits for pictures
  // (settings.interactive), the error for a budget moves by small steps that nobody sees. Unless
  // the settings ask for full detail, expect() must have been called.
  double choose(const RenderSettings& settings);
  // Tells how many splats and nodes are in the picture. Returns the error [px] to draw it again
  // with, if it missed a budget that must hold at once.
  std::optional<double> adjust(double error, std::size_t drawn);
  // Why the last picture doesn't keep the budget: there may be more of the coarsest nodes than it
  // allows. Empty if it does.
  const std::string& problem() const { return problem_; }
  // Whether the error has arrived at the one that the budget needs.
  bool settled() const { return settled_; }

 private:
  // The search for an error that keeps a budget.
  struct Search {
    double most;  // splats
    bool at_once;
    double fine = 0;                 // the largest error so far at which too many were drawn
    std::optional<double> coarse{};  // the least at which few enough were
    int narrowed = 0;                // pictures since there is a coarse one
  };

  double errorForBudget() const;

  std::optional<CutEstimate> expected_;
  std::optional<Search> search_;  // while a budget is to be kept
  // Of the last picture. Only drawing shows which splats are hidden, and estimates err.
  double drawn_of_expected_ = 1;
  std::optional<double> error_;  // of the last picture [px]
  bool settled_ = true;
  std::string problem_;
};

}  // namespace rosplat
