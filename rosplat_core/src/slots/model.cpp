#include "rosplat_core/slots/model.hpp"

#include <array>
#include <stdexcept>

namespace rosplat {

namespace {

constexpr std::array<const char*, 4> kNames{"EWA", "EWA Antialiased", "Ray", "Disc"};

}  // namespace

Model modelOf(int number) {
  if (number >= 0 && number < int(kNames.size())) return Model(number);
  std::string known;
  for (std::size_t i = 0; i < kNames.size(); ++i) {
    known += (i > 0 ? ", " : "") + std::to_string(i) + " " + kNames[i];
  }
  throw std::invalid_argument("model: " + std::to_string(number) + " is none of " + known);
}

std::string nameOf(Model model) { return kNames.at(std::size_t(model)); }

}  // namespace rosplat
