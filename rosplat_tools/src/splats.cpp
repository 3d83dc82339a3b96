#include "rosplat_tools/splats.hpp"

#include <cmath>
#include <stdexcept>

#include "rosplat_sorter/splat_arrays.hpp"

namespace rosplat {

namespace {

void checkLength(const std::string& field, std::size_t length, std::size_t each, std::size_t n) {
  if (length == each * n) return;
  throw std::invalid_argument(field + ": expected " + std::to_string(each) +
                              " values for each of " + std::to_string(n) + " splats, got " +
                              std::to_string(length));
}

}  // namespace

int Splats::check() const {
  const std::size_t n = size();
  checkLength("positions", positions.size(), 3, n);
  checkLength("orientations", orientations.size(), 4, n);
  checkLength("scales", scales.size(), 3, n);
  checkLength("opacities", opacities.size(), 1, n);
  int degree = 0;
  while (degree < 3 && sh.size() > 3u * (degree + 1) * (degree + 1) * n) ++degree;
  if (sh.size() != 3u * (degree + 1) * (degree + 1) * n) {
    throw std::invalid_argument("sh: expected 3, 12, 27 or 48 values for each of " +
                                std::to_string(n) + " splats, got " + std::to_string(sh.size()));
  }
  for (const double x : origin) {
    if (!std::isfinite(x)) throw std::invalid_argument("origin: not finite");
  }
  for (const auto& [name, values] : channels) {
    if (!isChannelName(name)) {
      throw std::invalid_argument(
          "channel_names: a name is of 1 to 64 characters of ASCII, without spaces");
    }
    checkLength("channels '" + name + "'", values.size(), 1, n);
  }
  return degree;
}

}  // namespace rosplat
