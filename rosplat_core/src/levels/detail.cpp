#include "rosplat_core/levels/detail.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <locale>
#include <regex>
#include <sstream>
#include <stdexcept>

namespace rosplat {

namespace {

constexpr double kAim = 0.95;         // share of a budget or of all to aim at: estimates err
constexpr double kClose = 0.9;        // share of a budget to draw at least, if not all
constexpr double kLeastStep = 1.02;   // least factor from an error that missed to the next
constexpr int kMostNarrowed = 4;      // most pictures that only come closer to a budget
constexpr double kMostStep = 1.1;     // most factor of the error from picture to picture
constexpr double kLeastError = 0.25;  // finer errors draw all there is [px]

// The finest error that draws fewer splats than full detail. [px]
double finestOf(const CutEstimate& cut) {
  return std::max(kLeastError, cut.errorFor(kAim * cut.drawn(0)));
}

}  // namespace

Detail parseDetail(const std::string& text) {
  std::string word;
  for (const char c : text) {
    if (c != ' ') word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  // Commas may group thousands. Any other comma, as in 1,5 for 1.5, is refused below.
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
    const double factor = unit.empty() ? 1 : unit == "k" ? 1e3 : unit == "m" ? 1e6 : 0;
    if (factor * amount >= 1) return {Kind::kSplats, std::floor(factor * amount)};
  }
  throw std::invalid_argument(
      "detail '" + text.substr(0, 40) +
      "' is none: expected full, pixels (1.5px) or splats (800000, 800k, 2M)");
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
  }
  return text.str();
}

double DetailControl::choose(const RenderSettings& settings) {
  const Detail detail = settings.drawnDetail();
  const bool at_once = !settings.interactive;
  settled_ = true;
  search_.reset();
  problem_.clear();
  double wanted = 0, finest = 0;
  const auto drawable = [&finest](double error) { return error < finest ? 0 : error; };
  switch (detail.kind) {
    case Detail::Kind::kFull:
      return 0;
    case Detail::Kind::kError:
      finest = finestOf(*expected_);
      return drawable(detail.amount);
    case Detail::Kind::kSplats:
      search_ = Search{detail.amount, at_once};
      wanted = errorForBudget();
      if (at_once || wanted >= kCoarsestError) return wanted;
      finest = finestOf(*expected_);
      break;
  }
  wanted = drawable(wanted);
  // Without a picture, or with one of the coarsest nodes alone, there is nothing to move on from.
  if (!error_ || *error_ >= kCoarsestError) return wanted;
  // With a camera at rest the picture stays, though counts may differ in their last bits.
  if (std::fabs(wanted - *error_) <= (kLeastStep - 1) * *error_) return drawable(*error_);
  const double from = std::max(*error_, finest);
  const double error = drawable(std::clamp(wanted, from / kMostStep, from * kMostStep));
  settled_ = std::fabs(error - wanted) <= 0.05 * wanted;
  return error;
}

double DetailControl::errorForBudget() const {
  const double splats = search_->most / drawn_of_expected_;  // that the estimate would have
  const double all = expected_->errorFor(splats);
  return all == 0 ? 0 : expected_->errorFor(kAim * splats);
}

std::optional<double> DetailControl::adjust(double error, std::size_t drawn) {
  error_ = error;
  if (!search_) return {};
  Search& of = *search_;
  const double expected = expected_->drawn(error);
  if (drawn > 0 && expected > 0) drawn_of_expected_ = double(drawn) / expected;
  const bool fits = double(drawn) <= of.most;
  if (!fits && error >= kCoarsestError) {
    problem_ = "no fewer than " + std::to_string(drawn) + " splats can be drawn";
    return {};
  }
  if (!of.at_once || (fits && (error == 0 || double(drawn) >= kClose * of.most))) return {};

  // The next error is between the largest that drew too many and the least that drew few enough.
  const double tried = std::max(error, kLeastError);
  if (fits) {
    of.coarse = tried;
  } else {
    of.fine = tried;
    if (of.coarse <= tried) of.coarse.reset();  // another map of the picture hides less by now
  }
  const double next = errorForBudget();
  if (next == 0 && of.fine == 0) return 0;
  if (!of.coarse && expected == 0) return kCoarsestError;  // it knows none of these splats
  if (!of.coarse) {
    const double too_many = double(drawn) / of.most;
    return std::max(next, of.fine * std::clamp(std::sqrt(too_many), kLeastStep, 2.0));
  }
  const double least = kLeastStep * std::max(of.fine, kLeastError), most = *of.coarse / kLeastStep;
  if (++of.narrowed > kMostNarrowed || least > most) return fits ? std::nullopt : of.coarse;
  return least < next && next < most ? next : std::sqrt(least * most);
}

}  // namespace rosplat
