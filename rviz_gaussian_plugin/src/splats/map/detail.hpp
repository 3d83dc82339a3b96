#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "map/levels.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// Reads "full", an error in pixels ("1.5px"), a most of splats ("800000", "800k", "2M") or a frame
// time ("40ms"). Throws std::invalid_argument, naming what it can't read.
Detail parseDetail(const std::string& text);

std::string toText(const Detail& detail);

// The least error [px] at which a view draws no more splats and nodes than that, by samples: 0
// where it is all of them. groups: where those of the levels are, by index.
double errorForSplats(const std::vector<Levels::Nodes>& levels, const SplatCamera& camera,
                      const std::vector<Group>& groups, const ClipBox& box, double splats);

// Where nothing is left to be merged. [px]
constexpr double kCoarsestError = 1e15;

// A larger error, where one has had more drawn than there may be.
double coarserError(double error, std::size_t drawn, std::size_t most);

// Chooses the error of a view's pictures, one after the other.
class DetailControl {
 public:
  // For the next picture [px]; 0 has all drawn in full. at_once: whatever the last one had;
  // otherwise it moves towards what is asked for, so that nobody sees it move.
  double choose(const Detail& detail, bool at_once, const std::vector<Levels::Nodes>& levels,
                const SplatCamera& camera, const std::vector<Group>& groups, const ClipBox& box);
  // What became of it; and the time that one took, which may be known later.
  void drew(double error) { error_ = error; }
  void took(double error, double seconds);
  // Of a picture of all splats, whatever was chosen. [s]
  void drewAll(double seconds) { seconds_in_full_ = seconds; }
  double secondsInFull() const { return seconds_in_full_; }  // 0 before any
  // Whether levels are needed for it: a frame time may have room for all.
  bool needsLevels(const Detail& detail) const {
    if (detail.kind != Detail::Kind::kTime) return detail.kind != Detail::Kind::kFull;
    return seconds_ > 0 || seconds_in_full_ > detail.amount;
  }
  // Whether it is where it is going.
  bool settled() const { return settled_; }

 private:
  std::optional<double> error_;           // of the last picture [px]
  double timed_error_ = 0, seconds_ = 0;  // of the last one of which it is known
  double seconds_in_full_ = 0;
  bool settled_ = true;
};

}  // namespace rosplat
