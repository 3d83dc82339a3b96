#pragma once

#include <array>
#include <cstdint>

#include "gpu/frame.hpp"

namespace rosplat {

// What the shaders of a frame share, as splat_view.glsl has it (std140).
struct ViewBlock {
  explicit ViewBlock(const Frame& frame);

  using Flag = std::uint32_t;

  std::array<float, 3> box_size;
  Flag clip_to_box;
  Flag orthographic;
  std::int32_t mode;
  float near_fade;
  float unused = 0;
  std::array<float, 2> clip, focal, offset, half_size, slope, principal_point;
  std::array<float, 2> whole_principal_point, whole_picture;
  std::array<std::int32_t, 2> picture, tiles;
  std::array<float, 2> ndc_depth, depth_range, rise;
  float scale_modifier, opacity_modifier;
  std::int32_t sh_degree, only_band;
  Flag antialiased, top_first;
  float now, age_range;
  float cut_focal;
  Flag cut;
  float channel_least, channel_most, channel_per_range;
  std::int32_t channel_colours;
};

}  // namespace rosplat
