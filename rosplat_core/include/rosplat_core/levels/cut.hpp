#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/views/page_view.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// How far down a view goes from a group's coarsest nodes to its splats. The error e of a cell is
// its width in the picture, at its nearest point [px]. A node's share of what is drawn is
// s(e of its parent's cell) - s(e of its own), where s rises from 0 to 1 over half an octave that
// ends at the error that is allowed; the share of a splat is s(e of its parent's cell). So what is
// drawn depends on positions alone, and shares sum to 1 from each splat up to the coarsest node.
struct Cut {
  std::array<double, 3> eye{};  // relative to the group's origin [m]
  double focal = 1;             // [px], orthographic [px/m]
  bool orthographic = false;
  double from = 0, to = 0;  // where s rises [px]

  Cut() = default;
  // camera: in the group's frame; blends: else s is a step.
  Cut(const SplatCamera& camera, const std::array<double, 3>& origin, double error, bool blends)
      : eye(eyeOf(camera, origin)),
        focal(std::max(camera.fx, camera.fy)),
        orthographic(camera.orthographic),
        from(error * (blends ? std::sqrt(0.5) : 1 - 1e-5)),
        to(error) {}

  // The squared errors of cells, by their corners and size [m]. [px2]
  template <std::size_t N>
  std::array<float, N> squaredErrors(const std::array<std::array<float, N>, 3>& corners,
                                     float size) const;
  // Whether anything of a page may have a share. own: the width of its nodes' cells, 0 for splats;
  // parent: the width of the widest parent cell. [m]
  bool mayShow(const SlotPage& page, float own, float parent) const {
    PageBounds<1> bounds;
    bounds.put(0, page);
    return mayShow<1>(bounds, own, {parent})[0];
  }
  // The same for several pages: 1 or 0 each.
  template <std::size_t N>
  std::array<std::uint32_t, N> mayShow(const PageBounds<N>& pages, float own,
                                       const std::array<float, N>& parents) const;
};

template <std::size_t N>
std::array<float, N> Cut::squaredErrors(const std::array<std::array<float, N>, 3>& corners,
                                        float size) const {
  constexpr float kNearest = 1e-12f;  // squared [m2]
  std::array<float, N> errors{};      // squared distances at first
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const float at = static_cast<float>(eye[axis]);
    for (std::size_t i = 0; i < N; ++i) {
      const float below = corners[axis][i] - at, above = at - corners[axis][i] - size;
      const float outside = std::max(std::max(below, above), 0.0f);
      errors[i] += outside * outside;
    }
  }
  const float width = static_cast<float>(focal) * size;
  for (float& error : errors) {
    error = width * width / (orthographic ? 1.0f : std::max(error, kNearest));
  }
  return errors;
}

template <std::size_t N>
std::array<std::uint32_t, N> Cut::mayShow(const PageBounds<N>& pages, float own,
                                          const std::array<float, N>& parents) const {
  constexpr double kRounding = 1.001;
  std::array<float, N> nearest{}, farthest{};  // squared
  for (std::size_t axis = 0; axis < 3; ++axis) {
    // In two floats the eye is as exact as it has to be, at half the cost of a double.
    const float at = static_cast<float>(eye[axis]), rest = static_cast<float>(eye[axis] - at);
    for (std::size_t i = 0; i < N; ++i) {
      const float least = pages.least[axis][i] - at - rest;
      const float most = pages.most[axis][i] - at - rest;
      const float outside = std::max(std::max(least, -most) - parents[i], 0.0f);
      const float across = std::max(most, -least);
      nearest[i] += outside * outside;
      farthest[i] += across * across;
    }
  }
  if (orthographic) {
    nearest.fill(1);
    farthest.fill(1);
  }
  // All is squared and multiplied, nothing divided: maps have tens of thousands of pages.
  const float wide = static_cast<float>(kRounding * focal);
  const float narrow = static_cast<float>(focal / kRounding) * own;
  const float from_squared = static_cast<float>(from * from);
  const float to_squared = static_cast<float>(to * to);
  std::array<std::uint32_t, N> shows;
  for (std::size_t i = 0; i < N; ++i) {
    const float width = wide * parents[i];
    shows[i] = !isBeyond(from_squared * nearest[i], width * width) &
               !isBeyond(narrow * narrow, to_squared * farthest[i]);
  }
  return shows;
}

}  // namespace rosplat
