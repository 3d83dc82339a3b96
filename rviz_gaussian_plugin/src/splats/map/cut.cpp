#include "map/cut.hpp"

#include <algorithm>
#include <cmath>

namespace rosplat {

Cut::Cut(const SplatCamera& camera, const std::array<double, 3>& origin, double error, bool sharp)
    : eye(eyeOf(camera, origin)),
      focal(std::max(camera.fx, camera.fy)),
      orthographic(camera.orthographic),
      from(error * (sharp ? 1 - 1e-5 : std::sqrt(0.5))),
      to(error) {}

bool Cut::mayShow(const SlotPage& page, double own, double parent) const {
  constexpr double kRounding = 1.001;
  double nearest = 0, farthest = 0;  // squared
  for (std::size_t i = 0; i < 3; ++i) {
    const double below = page.least[i] - parent - eye[i], above = eye[i] - page.most[i] - parent;
    const double outside = std::max({below, above, 0.0});
    const double across = std::max(page.most[i] - eye[i], eye[i] - page.least[i]);
    nearest += outside * outside;
    farthest += across * across;
  }
  if (orthographic) nearest = farthest = 1;
  // Squares of errors times distances: maps have tens of thousands of pages.
  const double most = kRounding * focal * parent, least = focal * own / kRounding;
  return most * most > from * from * nearest && least * least <= to * to * farthest;
}

}  // namespace rosplat
