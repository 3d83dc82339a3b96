#include "map/detail.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <locale>
#include <numeric>
#include <regex>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "map/cut.hpp"
#include "map/seen_group.hpp"

namespace rosplat {

namespace {

constexpr double kAim = 0.95;         // of a most, where not all may be drawn: samples err
constexpr double kFirstSplats = 1e6;  // of a frame time, before any was measured
constexpr double kMostStep = 1.1;     // of the error, from picture to picture
constexpr double kLeastError = 0.25;  // what is finer is all there is [px]
constexpr double kNearTime = 0.1;     // of a frame time, which varies from frame to frame

// Errors are counted by 32nds of their octave: by the first bits of floats, which grow with them.
constexpr int kLeastOctave = -6, kOctaves = 30, kDropped = 23 - 5;  // of a float's 23 bits
constexpr std::uint32_t kLeastBits = std::uint32_t(127 + kLeastOctave) << 5;
constexpr std::uint32_t kBins = std::uint32_t(kOctaves) << 5;

std::size_t binOf(double error) {
  const float value = static_cast<float>(std::min(error, 1e30));
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return std::clamp(bits >> kDropped, kLeastBits, kLeastBits + kBins - 1) - kLeastBits;
}

// The least error of a bin.
double errorOf(std::size_t bin) {
  const std::uint32_t bits = (kLeastBits + static_cast<std::uint32_t>(bin)) << kDropped;
  float value;
  std::memcpy(&value, &bits, sizeof(value));
  return value;
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
  constexpr std::size_t kStride = 61;         // of nodes
  constexpr std::size_t kMostPages = 1 << 7;  // of a level; most levels have few
  // How many more are drawn where the error that is allowed falls below a bin's.
  std::vector<double> more(kBins);
  // weight: of how many pages this is one.
  const auto sample = [&](const NodePage& page, const PageView& view, const Cut& cut,
                          double weight) {
    if (!view.mayShow(page.bounds)) return;
    const double size = cellSize(page.level());
    const bool top = page.level() + 1 == kLevels;
    const std::size_t nodes = page.cells.size(), samples = (nodes + kStride - 1) / kStride;
    const double of_nodes = weight * double(nodes) / double(samples);
    const double of_members = weight * double(page.members()) / double(samples);
    for (std::size_t i = 0; i < samples; ++i) {
      const std::size_t at = i * nodes / samples;
      SlotPage point = page.bounds;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        point.least[axis] = point.most[axis] = page.slots.position[axis][at];
      }
      point.extent = page.slots.extent[at];
      if (!view.mayShow(point)) continue;
      // Splats are drawn below the end of the rise of their parent's share, nodes also above the
      // beginning of their own.
      const double own = cut.errorOf(point.least, size);
      more[binOf(std::sqrt(2) * own)] += of_members;
      more[top ? more.size() - 1 : binOf(std::sqrt(2) * cut.errorOf(point.least, 2 * size))] +=
          of_nodes;
      more[binOf(own)] -= of_nodes;
    }
  };
  for (std::size_t group = 0; group < levels.size(); ++group) {
    const SeenGroup seen(camera, groups[group], box);
    const Cut cut(seen.camera, groups[group].originOrZero(), 1, true);
    for (const Levels::Pages& pages : levels[group]) {
      const std::size_t step = (pages.size() + kMostPages - 1) / kMostPages;
      for (std::size_t i = 0; i < pages.size(); i += step) {
        sample(*pages[i], seen.pages, cut, double(step));
      }
    }
  }
  // Where levels blend, more may be drawn than there are splats.
  if (std::accumulate(more.begin(), more.end(), 0.0) <= splats) return 0;
  double drawn = 0;
  std::size_t bin = more.size();
  while (bin > 0 && drawn + more[bin - 1] <= kAim * splats) drawn += more[--bin];
  return errorOf(bin);
}

double coarserError(double error, std::size_t drawn, std::size_t most) {
  return std::max(error, kLeastError) *
         std::clamp(std::sqrt(double(drawn) / double(most)), 1.01, 2.0);
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
