#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "cpu/cpu_rasterizer.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// A picture on a mesh of cells of 16x16 pixels, whose corners are where the splats around them are:
// what another camera sees of it is about what it sees of the splats, as long as it isn't far (3D
// warping; Mark, McMillan and Bishop 1997). A cell more all around, its edges go on beyond the
// picture, which is nearer to what comes in there than nothing.
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
    bool moved;  // not the picture's own camera
  };
  // Which cells have something in them, row by row. Those beyond the picture are like the nearest
  // in it.
  using Cells = std::vector<bool>;

  PictureMesh() = default;
  // Of a picture with its mean depth, and the camera that sees it.
  PictureMesh(const SplatCamera& camera, const SplatPicture& picture);

  // Of a picture, given by what pixels are filled.
  template <typename Filled>
  static Cells cells(int width, int height, const Filled& filled);

  // As a camera of the same map sees it.
  View seenBy(const SplatCamera& camera) const;

 private:
  SplatCamera camera_;
  int columns_ = 0, rows_ = 0;  // of corners
  std::vector<float> depths_;   // of corners [m]; of perspective cameras one over it
};

template <typename Filled>
PictureMesh::Cells PictureMesh::cells(int width, int height, const Filled& filled) {
  const int columns = (width + kCell - 1) / kCell, rows = (height + kCell - 1) / kCell;
  Cells cells;
  for (int row = -1; row <= rows; ++row) {
    for (int column = -1; column <= columns; ++column) {
      const int left = kCell * std::clamp(column, 0, columns - 1);
      const int top = kCell * std::clamp(row, 0, rows - 1);
      bool any = false;
      for (int y = top; !any && y < std::min(top + kCell, height); ++y) {
        for (int x = left; !any && x < std::min(left + kCell, width); ++x) {
          any = filled(static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                       static_cast<std::size_t>(x));
        }
      }
      cells.push_back(any);
    }
  }
  return cells;
}

}  // namespace rosplat
