#include "map/detail.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <locale>
#include <numeric>
#include <regex>
#include <sstream>
#include <stdexcept>

#include "map/cut.hpp"
#include "map/seen_group.hpp"

namespace rosplat {

namespace {

constexpr double kAim = 0.95;         // of a most, where not all may be drawn: samples err
constexpr double kFirstSplats = 1e6;  // of a frame time, before any was measured
constexpr double kMostStep = 1.1;     // of the error, from picture to picture
constexpr double kLeastError = 0.25;  // what is finer is all there is [px]
constexpr double kNearTime = 0.1;     // of a frame time, which varies from frame to frame

// Squared errors are counted by 16ths of their octave: by the first bits of floats, which grow with
// them.
constexpr int kOctaveBits = 4, kDropped = 23 - kOctaveBits;  // of a float's 23 bits
constexpr int kOctave = 1 << kOctaveBits, kBins = 60 * kOctave;
constexpr int kLeastBits = (127 - 12) * kOctave;  // of 2^-12

using Bins = NodeSamples::Each<int>;

Bins binsOf(const NodeSamples::Each<float>& squared) {
  Bins bins;
  for (std::size_t i = 0; i < bins.size(); ++i) {
    std::int32_t bits;
    std::memcpy(&bits, &squared[i], sizeof(bits));
    // Room for half an octave of errors more.
    bins[i] = std::clamp((bits >> kDropped) - kLeastBits, 0, kBins - 1 - kOctave);
  }
  return bins;
}

// The least error of a bin.
double errorOf(int bin) {
  const std::int32_t bits = (kLeastBits + bin) << kDropped;
  float squared;
  std::memcpy(&squared, &bits, sizeof(squared));
  return std::sqrt(squared);
}

}  // namespace

Detail parseDetail(const std::string& text) {
  std::string word;
  for (const char c : text) {
    if (c != ' ') word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  // Thousands of splats; who writes 1,5 for 1.5 is told.
  if (std::regex_match(word, std::regex("[1-9][0-9]{0,2}(,[0-9]{3})+"))) {
    word.erase(std::remove(word.begin(), word.end(), ','), word.end());
  }
  if (word == "full") return {};
  std::istringstream in(word);
  in.imbue(std::locale::classic());
  double amount = 0;
  std::string unit;
  in >> amount >> unit;
  using Kind = Detail::Kind;
  constexpr double kMost = 1e9;
  if (amount > 0 && amount < kMost) {
    if (unit == "px") return {Kind::kError, amount};
    if (unit == "ms") return {Kind::kTime, amount * 1e-3};
    const double factor = unit.empty() ? 1 : unit == "k" ? 1e3 : unit == "m" ? 1e6 : 0;
    if (factor * amount >= 1) return {Kind::kSplats, std::floor(factor * amount)};
  }
  throw std::invalid_argument(
      "detail '" + text.substr(0, 40) +
      "' is none: expected full, pixels (1.5px), splats (800000, 800k, 2M) or a time (40ms)");
}

std::string toText(const Detail& detail) {
  std::ostringstream text;
  const double amount = detail.amount;
  switch (detail.kind) {
    case Detail::Kind::kFull:
      text << "full";
      break;
    case Detail::Kind::kError:
      text << amount << "px";
      break;
    case Detail::Kind::kSplats:
      text << static_cast<std::uint64_t>(amount);
      break;
    case Detail::Kind::kTime:
      text << 1e3 * amount << "ms";
      break;
  }
  return text.str();
}

double errorForSplats(const std::vector<Levels::Nodes>& levels, const SplatCamera& camera,
                      const std::vector<Group>& groups, const ClipBox& box, double splats) {
  constexpr std::size_t kMostPages = 1 << 6;  // of a level; most levels have few
  // How many more are drawn where the error that is allowed falls below a bin's.
  std::array<double, kBins> more{};
  // weight: of how many pages this is one.
  const auto count = [&](const NodePage& page, int level, const PageView& view, const Cut& cut,
                         double weight) {
    if (!view.mayShow(page.bounds)) return;
    const float size = cellSize(level);
    const bool top = level + 1 == kLevels;
    const NodeSamples& samples = page.samples;
    const auto shown = view.mayShow(samples.position, samples.extent);
    const Bins own = binsOf(cut.squaredErrors(samples.corner, size));
    const Bins parents = binsOf(cut.squaredErrors(samples.parent_corner, 2 * size));
    const double nodes = weight * samples.nodes, members = weight * samples.members;
    for (std::size_t i = 0; i < NodeSamples::kCount; ++i) {
      if (!shown[i]) continue;
      // Splats are drawn below the end of the rise of their parent's share, half an octave up;
      // nodes also above the beginning of their own.
      more[std::size_t(own[i] + kOctave)] += members;
      more[std::size_t(top ? kBins - 1 : parents[i] + kOctave)] += nodes;
      more[std::size_t(own[i])] -= nodes;
    }
  };
  for (std::size_t group = 0; group < levels.size(); ++group) {
    const SeenGroup seen(camera, groups[group], box);
    const Cut cut(seen.camera, groups[group].originOrZero(), 1, true);
    for (int level = 0; level < kLevels; ++level) {
      const Levels::Pages& pages = levels[group][std::size_t(level)];
      const std::size_t step = (pages.size() + kMostPages - 1) / kMostPages;
      for (std::size_t i = 0; i < pages.size(); i += step) {
        count(*pages[i], level, seen.pages, cut, double(step));
      }
    }
  }
  // Where levels blend, more may be drawn than there are splats.
  if (std::accumulate(more.begin(), more.end(), 0.0) <= splats) return 0;
  double drawn = 0;
  int bin = kBins;
  while (bin > 0 && drawn + more[std::size_t(bin - 1)] <= kAim * splats) {
    drawn += more[std::size_t(--bin)];
  }
  return errorOf(bin);
}

double coarserError(double error, std::size_t drawn, std::size_t most) {
  // From within a scene hardly more than one in so many is left, not its square. A second picture
  // costs more than what a tenth more of error does.
  return std::max(error, kLeastError) * std::clamp(double(drawn) / double(most), 1.1, 2.0);
}

double DetailControl::choose(const Detail& detail, bool at_once,
                             const std::vector<Levels::Nodes>& levels, const SplatCamera& camera,
                             const std::vector<Group>& groups, const ClipBox& box) {
  const auto forSplats = [&](double splats) {
    return errorForSplats(levels, camera, groups, box, splats);
  };
  settled_ = true;
  double wanted = 0;
  switch (detail.kind) {
    case Detail::Kind::kFull:
      return 0;
    case Detail::Kind::kError:
      return detail.amount;
    case Detail::Kind::kSplats:
      wanted = forSplats(detail.amount);
      if (at_once) return wanted;
      break;
    case Detail::Kind::kTime: {
      if (seconds_ == 0) return error_ ? *error_ : forSplats(kFirstSplats);
      const double part = seconds_ / detail.amount;
      if (error_ == timed_error_ && std::fabs(part - 1) <= kNearTime) return timed_error_;
      // About as many are drawn as the square of the error leaves.
      wanted = std::max(timed_error_, kLeastError) * std::sqrt(part);
      if (wanted < kLeastError) wanted = 0;
      break;
    }
  }
  if (!error_) return wanted;  // nobody saw another
  const double from = std::max(*error_, kLeastError);
  double error = std::clamp(wanted, from / kMostStep, from * kMostStep);
  if (error < kLeastError && wanted == 0) error = 0;
  settled_ = std::fabs(error - wanted) <= 0.05 * wanted;
  return error;
}

void DetailControl::took(double error, double seconds) {
  timed_error_ = error;
  seconds_ = seconds;
}

}  // namespace rosplat
