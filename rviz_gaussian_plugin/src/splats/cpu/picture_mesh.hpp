#pragma once

#include <cstddef>
#include <vector>

#include "cpu/cpu_rasterizer.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// A picture on a mesh of cells of 16x16 pixels, whose corners are where the splats around them are:
// what another camera sees of it is about what it sees of the splats, as long as it isn't far (3D
// warping; Mark, McMillan and Bishop 1997). Its edges go on beyond the picture, which is nearer to
// what comes in there than nothing.
class PictureMesh {
 public:
  static constexpr int kCell = 16;  // [px]; twice that costs playbot 3 dB, half of it gains nothing

  struct Corner {
    float x, y, w;  // where a camera sees it: clip coordinates, y up
    float u, v;     // what is there: 0 to 1 over the picture, from its top left; or beyond
  };
  // Corners row by row, from the top left.
  struct View {
    std::size_t columns;
    std::vector<Corner> corners;
  };

  PictureMesh() = default;
  // Of a picture with its mean depth, and the camera that sees it.
  PictureMesh(const SplatCamera& camera, const SplatPicture& picture);

  // As another camera of the same map sees it.
  View seenBy(const SplatCamera& camera) const;

 private:
  SplatCamera camera_;
  int columns_ = 0, rows_ = 0;  // of corners
  std::vector<float> depths_;   // of corners [m]; of perspective cameras one over it
};

}  // namespace rosplat
