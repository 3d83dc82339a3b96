#include "rosplat_core/levels/cut_estimate.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "rosplat_core/levels/cut.hpp"
#include "rosplat_core/views/seen_group.hpp"

namespace rosplat {

namespace {

// The first bits of a squared error's float are its bin: 16 bins an octave, from 2^-12 px^2 on.
constexpr int kOctaveBits = 4, kOctave = 1 << kOctaveBits;
constexpr int kDropped = 23 - kOctaveBits;  // of a float's 23 bits
constexpr int kLeastBits = (127 - 12) * kOctave;

std::int32_t bitsOf(float value) {
  std::int32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return bits;
}

// The error [px] at a place among bins, which may be between two.
double errorAt(double place) {
  const auto bits = static_cast<std::int32_t>((kLeastBits + place) * (1 << kDropped));
  float squared;
  std::memcpy(&squared, &bits, sizeof(squared));
  return std::sqrt(squared);
}

}  // namespace

CutEstimate::CutEstimate(const std::vector<LevelSamples>& levels, const SplatCamera& camera,
                         const std::vector<Group>& groups, const RenderSettings& settings) {
  using Places = NodeSamples::Each<int>;
  const auto binsOf = [](const NodeSamples::Each<float>& squared) {
    Places bins;
    for (std::size_t i = 0; i < bins.size(); ++i) {
      // Leaves room for half an octave of errors, which is an octave of their squares.
      bins[i] =
          std::clamp((bitsOf(squared[i]) >> kDropped) - kLeastBits, 0, int(kBins) - 1 - kOctave);
    }
    return bins;
  };
  const int rise = settings.blendsLevels() ? kOctave : 0;
  // For each bin, how many more are drawn as soon as the allowed error falls below it.
  std::array<double, kBins + 1>& more = drawn_;
  for (std::size_t group = 0; group < levels.size(); ++group) {
    const SeenGroup seen(camera, groups[group], settings.clip_box);
    const Cut cut(seen.camera, groups[group].originOrZero(), 1, false);
    int last = kLevels - 1;  // the coarsest level that has nodes
    while (last > 0 && levels[group][std::size_t(last)].empty()) --last;
    for (int level = 0; level <= last; ++level) {
      const float size = cellSize(level);
      for (const NodeSamples& samples : levels[group][std::size_t(level)]) {
        const auto shown = seen.pages.mayShow(samples.position, samples.extent);
        const Places own = binsOf(cut.squaredErrors(samples.corner, size));
        const Places parents = binsOf(cut.squaredErrors(samples.parent_corner, 2 * size));
        for (std::size_t i = 0; i < NodeSamples::kCount; ++i) {
          if (!shown[i]) continue;
          // Splats are drawn at errors below their cell's (half an octave above it where levels
          // blend), nodes below their parent cell's (likewise) and above their own cell's.
          more[std::size_t(own[i] + rise)] += samples.members[i];
          more[std::size_t(level == last ? kBins - 1 : parents[i] + rise)] += samples.nodes[i];
          more[std::size_t(own[i])] -= samples.nodes[i];
        }
      }
    }
  }
  for (std::size_t bin = kBins; bin-- > 0;) drawn_[bin] += drawn_[bin + 1];
}

double CutEstimate::drawn(double error) const {
  const double bits = bitsOf(static_cast<float>(error * error));
  const double place = std::clamp(bits / (1 << kDropped) - kLeastBits, 0.0, double(kBins));
  const std::size_t bin = std::min(static_cast<std::size_t>(place), kBins - 1);
  return drawn_[bin] + (place - double(bin)) * (drawn_[bin + 1] - drawn_[bin]);
}

double CutEstimate::errorFor(double splats) const {
  // Where levels blend, more may be drawn than there are splats.
  if (drawn_[0] <= splats) return 0;
  std::size_t bin = kBins;
  while (drawn_[bin - 1] <= splats) --bin;
  if (bin == kBins) return kCoarsestError;
  const double more = drawn_[bin - 1] - drawn_[bin];
  return errorAt(double(bin) - (splats - drawn_[bin]) / more);
}

}  // namespace rosplat
