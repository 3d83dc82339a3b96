#include "rosplat_core/slots/splats.hpp"

#include <cmath>
#include <cstring>
#include <set>
#include <stdexcept>

#include "rosplat_core/slots/packed_slot.hpp"

namespace rosplat {

namespace {

void checkLength(const std::string& field, std::size_t length, std::size_t each, std::size_t n) {
  if (length == each * n) return;
  throw std::invalid_argument(field + ": expected " + std::to_string(each) +
                              " values for each of " + std::to_string(n) + " splats, got " +
                              std::to_string(length));
}

}  // namespace

std::array<float, 3> SplatsView::position(std::size_t i) const {
  std::array<float, 3> position;
  const void* const from = rows ? static_cast<const void*>(rows + rowWords(arrays.sh_degree) * i)
                                : arrays.positions + 3 * i;
  std::memcpy(position.data(), from, sizeof(position));
  return position;
}

void SplatsView::check() const {
  for (const double x : origin) {
    if (!std::isfinite(x)) throw std::invalid_argument("origin: not finite");
  }
  std::set<std::string> names;
  for (const auto& [name, values] : channels) {
    if (!names.insert(name).second) {
      throw std::invalid_argument("channel_names: '" + name + "' is there twice");
    }
    if (!isChannelName(name)) {
      throw std::invalid_argument(
          "channel_names: a name is of 1 to 64 characters of ASCII, without spaces");
    }
  }
}

Splats Splats::fromTrained(std::vector<float> means, const std::vector<float>& quaternions_wxyz,
                           const std::vector<float>& log_scales, const std::vector<float>& logits,
                           const std::vector<float>& sh0, const std::vector<float>& shN) {
  const std::size_t n = means.size() / 3;
  checkLength("means", means.size(), 3, n);
  checkLength("quaternions_wxyz", quaternions_wxyz.size(), 4, n);
  const bool spheres = log_scales.size() == n;
  checkLength("log_scales", log_scales.size(), spheres ? 1 : 3, n);
  checkLength("logits", logits.size(), 1, n);
  checkLength("sh0", sh0.size(), 3, n);
  const std::size_t rest = n > 0 ? shN.size() / n : 0;
  if (shN.size() != rest * n || (rest != 0 && rest != 9 && rest != 24 && rest != 45)) {
    throw std::invalid_argument("shN: expected 0, 9, 24 or 45 values for each of " +
                                std::to_string(n) + " splats, got " + std::to_string(shN.size()));
  }
  Splats splats;
  splats.positions = std::move(means);
  for (std::size_t i = 0; i < n; ++i) {
    const float* const q = &quaternions_wxyz[4 * i];
    for (const int k : {1, 2, 3, 0}) splats.orientations.push_back(q[k]);
    for (std::size_t k = 0; k < 3; ++k) {
      splats.scales.push_back(std::exp(log_scales[spheres ? i : 3 * i + k]));
    }
    splats.opacities.push_back(1 / (1 + std::exp(-logits[i])));
    splats.sh.insert(splats.sh.end(), &sh0[3 * i], &sh0[3 * i] + 3);
    splats.sh.insert(splats.sh.end(), shN.data() + rest * i, shN.data() + rest * (i + 1));
  }
  return splats;
}

SplatArrays<float> Splats::resize(std::size_t n, int sh_degree) {
  positions.resize(3 * n);
  orientations.resize(4 * n);
  scales.resize(3 * n);
  opacities.resize(n);
  sh.resize(harmonicsOf(sh_degree) * n);
  return {
      n,        sh_degree, positions.data(), orientations.data(), scales.data(), opacities.data(),
      sh.data()};
}

SplatsView Splats::view() const {
  const std::size_t n = size();
  checkLength("positions", positions.size(), 3, n);
  checkLength("orientations", orientations.size(), 4, n);
  checkLength("scales", scales.size(), 3, n);
  checkLength("opacities", opacities.size(), 1, n);
  SplatsView view;
  int& degree = view.arrays.sh_degree;
  while (degree < 3 && sh.size() > view.arrays.shStride() * n) ++degree;
  if (sh.size() != view.arrays.shStride() * n) {
    throw std::invalid_argument("sh: expected 3, 12, 27 or 48 values for each of " +
                                std::to_string(n) + " splats, got " + std::to_string(sh.size()));
  }
  view.arrays = {
      n, degree, positions.data(), orientations.data(), scales.data(), opacities.data(), sh.data()};
  view.origin = origin;
  view.model = model;
  for (const auto& [name, values] : channels) {
    checkLength("channels '" + name + "'", values.size(), 1, n);
    view.channels.emplace_back(name, values.data());
  }
  view.check();
  return view;
}

}  // namespace rosplat
