#pragma once

#include <array>

#include "gl/gl_objects.hpp"
#include "map/render_settings.hpp"

namespace rosplat {

// How splats get into a target, beside their order.
struct Raster {
  bool top_first = false;  // the target's first row is the picture's top
  bool orthographic = false;
  double ndc_scale = 0, ndc_offset = 0;  // as in SplatCamera
  DrawMode mode = DrawMode::kColor;
  std::array<float, 2> depth_range{};  // of kDepth [m]; empty: that of what is drawn

  // The uniforms of a program.
  void set(const gl::Program& program) const {
    program.set("orthographic", int(orthographic));
    program.set("ndc_depth", ndc_scale, ndc_offset);
    program.set("mode", static_cast<int>(mode));
    glUniform2fv(program.at("depth_range"), 1, depth_range.data());
  }
};

}  // namespace rosplat
