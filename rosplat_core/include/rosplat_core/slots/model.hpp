#pragma once

#include <string>

#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

// The model of a number from a message. Throws std::invalid_argument, which names the number and
// the models, for one that isn't known.
Model modelOf(int number);
inline bool isEwa(Model model) { return model <= Model::kEwaAntialiased; }
// As the display's property Model calls it.
std::string nameOf(Model model);

}  // namespace rosplat
