#include "rosplat_core/slots/constants.hpp"

#include <cstdint>
#include <cstdio>

#include "gl/shaders.hpp"
#include "rosplat_core/views/conic.hpp"

namespace rosplat {

namespace {

std::string constant(const char* name, int value) {
  return "const int " + std::string(name) + " = " + std::to_string(value) + ";\n";
}

std::string constant(const char* name, std::uint32_t value) {
  return "const uint " + std::string(name) + " = " + std::to_string(value) + "u;\n";
}

// To the bit: nine digits tell one float from the next.
std::string constant(const char* name, float value) {
  char digits[32];
  std::snprintf(digits, sizeof(digits), "%.8e", double(value));
  return "const float " + std::string(name) + " = " + digits + ";\n";
}

std::string constant(const char* name, double value) { return constant(name, float(value)); }

}  // namespace

std::string constantsInGlsl() {
  std::string glsl;
#define CONSTANT(name) glsl += constant(#name, name)
#define MODEL(name) glsl += constant(#name, static_cast<int>(Model::name))
#define MODE(name) glsl += constant(#name, static_cast<int>(DrawMode::name))
  MODE(kDepth);
  MODE(kBillboard);
  MODE(kNormals);
  MODE(kOpacity);
  MODE(kAge);
  MODE(kChannel);
  MODEL(kEwaAntialiased);
  MODEL(kRay);
  MODEL(kDisc);
  CONSTANT(kSpot);
  CONSTANT(kLeastAhead);
  CONSTANT(kNoColours);
  CONSTANT(kCategories);
  CONSTANT(kPageSlots);
  CONSTANT(kLowPass);
  CONSTANT(kCutoffAlpha);
  CONSTANT(kTransparentInTiles);
  CONSTANT(kTangentSlack);
  CONSTANT(kMaxSigmas);
  CONSTANT(kMaxAlpha);
  CONSTANT(kBallEdge);
  CONSTANT(kHalfLog2);
  CONSTANT(kMostNodeOpacity);
  CONSTANT(kLeastPicked);
  CONSTANT(kTile);
  CONSTANT(kLevels);
  CONSTANT(kFinestOctave);
  CONSTANT(kBoundless);
#undef CONSTANT
#undef MODE
#undef MODEL
  return glsl;
}

}  // namespace rosplat
