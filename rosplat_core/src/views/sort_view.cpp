#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

SortView sortView(const SplatCamera& camera, const std::array<double, 3>& origin, double overscan) {
  const std::array<double, 3> t = camera(origin);
  const auto view = [&](double cx, double cy, double width, double height) {
    return makeSortView(camera.rotation.data(), t.data(), camera.fx, camera.fy, cx, cy, width,
                        height, camera.near_clip, camera.far_clip, camera.orthographic,
                        camera.extent_scale, overscan);
  };
  SortView part = view(camera.cx, camera.cy, camera.width, camera.height);
  // A part's footprints grow as in the whole picture.
  const SplatCamera::Whole whole = camera.whole();
  const SortView all = view(whole.cx, whole.cy, whole.width, whole.height);
  part.slope_x = all.slope_x;
  part.slope_y = all.slope_y;
  return part;
}

}  // namespace rosplat
