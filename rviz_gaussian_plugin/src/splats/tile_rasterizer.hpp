#pragma once

#include <array>
#include <cstddef>

#include "gl_objects.hpp"
#include "projection.hpp"
#include "radix_sort.hpp"
#include "shaders.hpp"

namespace rosplat {

// How splats get into a target, beside their order.
struct Raster {
  bool top_first = false;  // the target's first row is the picture's top
  bool orthographic = false;
  double ndc_scale = 0, ndc_offset = 0;  // as in SplatCamera
  DrawMode mode = DrawMode::kColor;
  std::array<float, 2> depth_range{};  // of kDepth [m]; empty: that of what is drawn

  void set(const gl::Program& program) const;
};

// Draws ordered splats in compute shaders (Kerbl et al. 2023): lists them by tiles of the picture,
// then blends each pixel front to back in 32-bit floats and stops where nothing more can be seen.
class TileRasterizer {
 public:
  // The sort may be one that others use too.
  TileRasterizer(const Shaders& shaders, RadixSort& sort);

  // drawn: indices of ellipses, nearest first. Overwrites the target's colour where its depth lets
  // a splat pass. False, and nothing is drawn, where the lists would take too much memory.
  bool draw(const Projection& projection, const gl::Buffer& drawn, std::size_t count,
            const gl::Target& target, const Raster& raster, gl::Stopwatch& stopwatch);

  // The splats or their order aren't those of the last draw() any more.
  void forget() { listed_width_ = 0; }

  std::size_t bytes() const;

 private:
  bool list(const Projection& projection, const gl::Buffer& drawn, std::size_t count, int across,
            int down, gl::Stopwatch& stopwatch);

  gl::Program count_, list_, ranges_, blend_;
  PrefixSum prefix_sum_;
  RadixSort& sort_;
  gl::Buffer counts_, total_, tiles_, splats_, tile_ranges_;
  std::size_t most_listed_;
  int listed_width_ = 0, listed_height_ = 0;  // the picture that the lists are for [px]
};

}  // namespace rosplat
