#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/views/group_view.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// The reach of the low-pass filter, 3.33 * sqrt(0.3) = 1.82 px, and of a disc's spot, 3.33 *
// sqrt(0.5) = 2.35 px, with room for rounding.
constexpr double kMarginPixels = 2.5;

// How much wider than the picture an order is culled: by the time it is drawn, the camera has moved
// on to splats beyond the picture. 1.25 saves 11 dB after a turn of 3 degrees (docs/stability.md).
constexpr double kOverscan = 1.25;

// Returns the SortView of a camera. rotation: map to camera optical frame, row-major. translation:
// the positions' origin in the camera frame [m]; if it is beyond float32, nothing is visible. The
// intrinsics and extent_scale are as in ViewCamera.
inline SortView makeSortView(const double rotation[9], const double translation[3], double fx,
                             double fy, double cx, double cy, double width, double height,
                             double near_clip, double far_clip, bool orthographic,
                             double extent_scale = 1.0, double overscan = kOverscan) {
  // A perspective footprint grows with the slope of its ray, which the renderer clamps as here.
  const auto slope = [=](double focal, double centre, double size) {
    if (orthographic) return extent_scale * focal;
    const double tangent = std::max(size - centre, centre) / focal + kTangentSlack * (size / focal);
    return extent_scale * focal * std::sqrt(1.0 + tangent * tangent);
  };
  SortView view;
  std::copy(rotation, rotation + 9, view.rotation);
  float* const t = view.translation;
  std::copy(translation, translation + 3, t);
  if (!(std::isfinite(t[0]) && std::isfinite(t[1]) && std::isfinite(t[2]))) {
    // An infinite depth is never nearer than far_clip.
    std::fill(t, t + 3, std::numeric_limits<float>::infinity());
  }
  view.fx = static_cast<float>(fx);
  view.fy = static_cast<float>(fy);
  view.offset_x = static_cast<float>(cx - width / 2.0);
  view.offset_y = static_cast<float>(cy - height / 2.0);
  view.half_width = static_cast<float>(overscan * width / 2.0 + kMarginPixels);
  view.half_height = static_cast<float>(overscan * height / 2.0 + kMarginPixels);
  view.slope_x = static_cast<float>(slope(fx, cx, width));
  view.slope_y = static_cast<float>(slope(fy, cy, height));
  view.near_clip = static_cast<float>(near_clip);
  view.far_clip = static_cast<float>(far_clip);
  view.orthographic = orthographic;
  return view;
}

// Returns the SortView of a camera for positions relative to `origin`.
SortView sortView(const SplatCamera& camera, const std::array<double, 3>& origin,
                  double overscan = kOverscan);

}  // namespace rosplat
