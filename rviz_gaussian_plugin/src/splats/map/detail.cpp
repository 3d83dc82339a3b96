#include "map/detail.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <locale>
#include <numeric>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "map/cut.hpp"
#include "map/seen_group.hpp"

namespace rosplat {

namespace {

constexpr double kFirstSplats = 1e6;  // of a frame time, before any was measured
constexpr double kMostStep = 1.1;     // of the error, from picture to picture
constexpr double kLeastError = 0.25;  // of a frame time; what is finer is all there is [px]

// Errors are counted by 32nds of an octave.
constexpr double kBins = 32, kLeastOctave = -6, kMostOctave = 24;

std::size_t binOf(double error) {
  const double octave = std::clamp(std::log2(error), kLeastOctave, kMostOctave);
  return static_cast<std::size_t>((octave - kLeastOctave) * kBins);
}

}  // namespace

Detail parseDetail(const std::string& text) {
  std::string word;
  for (const char c : text) {
    if (c != ' ' && c != ',')
      word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
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

double errorForSplats(const Levels& levels, const SplatCamera& camera,
                      const std::vector<Group>& groups, const ClipBox& box, double splats) {
  constexpr std::size_t kStride = 61;  // of nodes
  // How many more are drawn where the error that is allowed falls below a bin's.
  std::vector<double> more(binOf(std::numeric_limits<double>::max()) + 1);
  const auto sample = [&](const NodePage& page, const PageView& view, const Cut& cut) {
    if (!view.mayShow(page.bounds)) return;
    const double size = cellSize(page.level());
    const bool top = page.level() + 1 == kLevels;
    const std::size_t nodes = page.cells.size(), samples = (nodes + kStride - 1) / kStride;
    const double of_nodes = double(nodes) / double(samples);
    const double of_members = double(page.members()) / double(samples);
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
  for (std::size_t group = 0; group < levels.groups().size(); ++group) {
    const SeenGroup seen(camera, groups[group], box);
    const Cut cut(seen.camera, groups[group].originOrZero(), 1, true);
    for (const Levels::Pages& level : levels.groups()[group]) {
      for (const auto& page : level) sample(*page, seen.pages, cut);
    }
  }
  // Where levels blend, more may be drawn than there are splats.
  if (std::accumulate(more.begin(), more.end(), 0.0) <= splats) return 0;
  double drawn = 0;
  std::size_t bin = more.size();
  while (bin > 0 && drawn + more[bin - 1] <= splats) drawn += more[--bin];
  return std::exp2(kLeastOctave + double(bin) / kBins);
}

double DetailControl::choose(const Detail& detail, bool at_once, const Levels& levels,
                             const SplatCamera& camera, const std::vector<Group>& groups,
                             const ClipBox& box) {
  const auto forSplats = [&](double splats) {
    return errorForSplats(levels, camera, groups, box, splats);
  };
  double wanted = 0;
  switch (detail.kind) {
    case Detail::Kind::kFull:
      break;
    case Detail::Kind::kError:
      wanted = detail.amount;
      break;
    case Detail::Kind::kSplats:
      wanted = forSplats(detail.amount);
      break;
    case Detail::Kind::kTime:
      // About as many are drawn as the square of the error leaves.
      wanted = seconds_ == 0 ? forSplats(kFirstSplats)
                             : std::max(error_, kLeastError) * std::sqrt(seconds_ / detail.amount);
      if (wanted < kLeastError) wanted = 0;
      break;
  }
  const bool moves =
      detail.kind == Detail::Kind::kTime || (detail.kind == Detail::Kind::kSplats && !at_once);
  double error = wanted;
  if (moves && seconds_ > 0) {
    const double from = std::max(error_, kLeastError);
    error = std::clamp(wanted, from / kMostStep, from * kMostStep);
    if (error < kLeastError && wanted == 0) error = 0;
  }
  settled_ = std::fabs(error - wanted) <= 0.05 * wanted;
  return error;
}

void DetailControl::drew(double error, double seconds) {
  error_ = error;
  seconds_ = seconds;
}

}  // namespace rosplat
