#pragma once

#include <array>
#include <cstdint>

#include "gl/buffer.hpp"
#include "gpu/frame.hpp"

namespace rosplat {

// What the shaders of a frame share, as splat_view.glsl has it (std140).
struct ViewBlock {
  explicit ViewBlock(const Frame& frame);

  using Flag = std::uint32_t;

  std::array<float, 2> clip, focal, offset, half_size, principal_point;
  std::array<float, 2> whole_principal_point, whole_picture, ndc_depth;
  std::array<std::int32_t, 2> picture, tiles;
  Flag orthographic, top_first, cut;
  float now;
};

// What the shaders of a map share, as splat_map.glsl has it (std140, which aligns vectors: so do
// these).
struct alignas(gl::Slice::kAlignment) MapBlock : SplatSettings {
  explicit MapBlock(const FrameLayer& layer);

  using Flag = std::uint32_t;

  alignas(16) std::array<float, 3> box_size;
  Flag clip_to_box;
  alignas(8) std::array<float, 2> slope, rise;
  std::uint32_t kind;
  std::int32_t sh_degree;
  std::int32_t model;
  Flag cut;
  float cut_focal;
  float channel_least, channel_most, channel_per_range;
  std::int32_t channel_colours;
};

}  // namespace rosplat
