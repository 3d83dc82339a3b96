#pragma once

#include <array>
#include <cstdint>

#include "gpu/frame.hpp"

namespace rosplat {

// What the shaders of a frame share, as splat_view.glsl has it (std140).
struct ViewBlock {
  explicit ViewBlock(const Frame& frame);

  using Flag = std::uint32_t;

  std::array<std::array<float, 4>, 3> rotation{};  // by columns
  std::array<float, 3> translation{};
  Flag orthographic;
  std::array<float, 3> eye{};
  std::int32_t mode;
  std::array<float, 3> box_centre{};
  Flag clip_to_box;
  std::array<float, 3> box_size;
  float near_fade;
  std::array<float, 2> clip, focal, offset, half_size, slope, principal_point;
  std::array<float, 2> whole_principal_point, whole_picture;
  std::array<std::int32_t, 2> picture, tiles;
  std::array<float, 2> ndc_depth, depth_range;
  float scale_modifier, opacity_modifier;
  std::int32_t sh_degree, only_band;
  Flag antialiased, top_first;
  float now, age_range;
};

}  // namespace rosplat
