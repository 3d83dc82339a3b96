#pragma once

#include <string>

namespace rosplat {

// The engine's constants that shaders use, in GLSL.
std::string constantsInGlsl();

}  // namespace rosplat
