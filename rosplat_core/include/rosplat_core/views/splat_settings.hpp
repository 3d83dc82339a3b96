#pragma once

#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

// Empty unless most > least.
struct Range {
  float least = 0, most = 0;

  bool empty() const { return !(most > least); }
};

// The settings that change splats one by one. Kernels and shaders read them as they stand here: the
// uniform block of splat_map.glsl begins with the same fields (std140). All are of four bytes, and
// none is padding: RenderSettings::sameSplats() compares bytes.
struct SplatSettings {
  Range depth_range;  // of kDepth [m]; empty: that of the splats drawn in kDepth
  DrawMode mode = DrawMode::kColor;
  int only_band = -1;    // draw one band of spherical harmonics alone; -1: all
  float scale = 1;       // of the splats' size
  float opacity = 1;     // of their opacity, 0 to 1
  float near_fade = 0;   // splats closer than this to the near plane fade out [m]
  float age_range = 10;  // of kAge [s]
};
static_assert(sizeof(SplatSettings) == 32,
              "splat_map.glsl has the same fields; count their bytes here");

}  // namespace rosplat
