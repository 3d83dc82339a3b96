#include "map/splat_camera.hpp"

#include <cmath>
#include <stdexcept>

namespace rosplat {

SplatCamera makeCamera(const std::array<double, 3>& position,
                       const std::array<double, 4>& orientation, bool orthographic, double fx,
                       double fy, double cx, double cy, double width, double height,
                       double near_clip, double far_clip) {
  constexpr double kLongestSide = 16384, kMostPixels = 1 << 25;  // 512 MiB of float colours
  const auto& [x, y, z, w] = orientation;
  const double norm = x * x + y * y + z * z + w * w;
  const auto check = [](bool good, const char* fault) {
    if (!good) throw std::invalid_argument(fault);
  };
  check(std::isfinite(position[0] + position[1] + position[2]), "pose.position is not finite");
  check(std::isnormal(norm), "pose.orientation is no rotation");
  check(fx > 0 && fy > 0 && std::isfinite(fx + fy + cx + cy), "fx, fy, cx, cy are no intrinsics");
  check(width >= 1 && height >= 1 && width <= kLongestSide && height <= kLongestSide &&
            width * height <= kMostPixels,
        "width and height must be 1 to 16384, and 2^25 pixels at most");
  check(near_clip < far_clip && (orthographic || near_clip > 0),
        "near_clip and far_clip are no range of depths");

  SplatCamera camera;
  const double s = 2 / norm;
  // The transpose of the pose's rotation.
  camera.rotation = {1 - s * (y * y + z * z), s * (x * y + w * z),     s * (x * z - w * y),
                     s * (x * y - w * z),     1 - s * (x * x + z * z), s * (y * z + w * x),
                     s * (x * z + w * y),     s * (y * z - w * x),     1 - s * (x * x + y * y)};
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) camera.translation[i] -= camera.rotation[3 * i + k] * position[k];
  }
  camera.orthographic = orthographic;
  camera.fx = fx;
  camera.fy = fy;
  camera.cx = cx;
  camera.cy = cy;
  camera.width = static_cast<int>(width);
  camera.height = static_cast<int>(height);
  camera.near_clip = near_clip;
  camera.far_clip = far_clip;
  return camera;
}

SplatCamera crop(const SplatCamera& camera, int left, int top, int width, int height) {
  SplatCamera part = camera;
  part.cx -= left;
  part.cy -= top;
  part.width = width;
  part.height = height;
  part.part_of = camera.whole();
  return part;
}

bool makePart(SplatCamera& camera, const SplatCamera& of) {
  constexpr double kSame = 1e-4;
  if (camera.orthographic != of.orthographic) return false;
  for (std::size_t i = 0; i < 9; ++i) {
    if (!(std::fabs(camera.rotation[i] - of.rotation[i]) < kSame)) return false;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    const double near = kSame * (1 + std::fabs(of.translation[i]));
    if (!(std::fabs(camera.translation[i] - of.translation[i]) < near)) return false;
  }
  const double x = camera.fx / of.fx, y = camera.fy / of.fy;
  camera.part_of = {x * of.cx, y * of.cy, x * of.width, y * of.height};
  return true;
}

}  // namespace rosplat
