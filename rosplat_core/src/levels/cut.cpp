#include "rosplat_core/levels/cut.hpp"

#include <cmath>

namespace rosplat {

Cut::Cut(const SplatCamera& camera, const std::array<double, 3>& origin, double error, bool blends)
    : eye(eyeOf(camera, origin)),
      focal(std::max(camera.fx, camera.fy)),
      orthographic(camera.orthographic),
      from(error * (blends ? std::sqrt(0.5) : 1 - 1e-5)),
      to(error) {}

bool Cut::mayShow(const SlotPage& page, float own, float parent) const {
  PageBounds<1> bounds;
  bounds.put(0, page);
  return mayShow<1>(bounds, own, {parent})[0];
}

}  // namespace rosplat
