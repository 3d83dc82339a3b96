#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/threads/in_parts.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A picture on a mesh of cells of 16x16 pixels. A corner has the mean depth of the splats around.
// So a camera near by sees the mesh about as it sees the splats (3D warping; Mark, McMillan and
// Bishop 1997). One more ring of cells continues the picture's edges outwards: that is nearer to
// what comes into view there than nothing.
class PictureMesh {
 public:
  static constexpr int kCell = 16;  // [px]; twice that costs playbot 3 dB, half of it gains nothing

  struct Corner {
    float x, y, w;  // where a camera sees the corner: clip coordinates, y up
    float u, v;     // texture coordinates: 0 to 1 over the picture, from its top left; or beyond
  };
  // Corners row by row, from the top left.
  struct CornerGrid {
    std::size_t columns;
    std::vector<Corner> corners;
    bool moved;  // the camera isn't the picture's own
  };
  // How much of a cell and of the pixels around hides the background.
  enum class Cover : std::uint8_t { kNothing, kSome, kAll };
  // The cells' cover, row by row. Cells of the outer ring are like the nearest in the picture.
  using Cells = std::vector<Cover>;

  PictureMesh() = default;
  // picture: with PictureDepth::kMean, as the camera sees it.
  PictureMesh(const SplatCamera& camera, const SplatPicture& picture);

  // Finds the cells' cover in a picture [px]; cover(first pixel, count) is that of pixels in a row.
  template <typename CoverOf>
  static Cells cells(int width, int height, ThreadTeam* team, const CoverOf& cover);

  // Returns the mesh as a camera of the same map sees it.
  CornerGrid seenBy(const SplatCamera& camera) const;

 private:
  SplatCamera camera_;
  int columns_ = 0, rows_ = 0;  // of corners
  std::vector<float> depths_;   // of corners: orthographic depth [m], perspective 1 / depth [1/m]
};

template <typename CoverOf>
PictureMesh::Cells PictureMesh::cells(int width, int height, ThreadTeam* team,
                                      const CoverOf& cover) {
  // With one more pixel around: a cell that has moved blends these pixels with its own.
  const auto coverAt = [&](int left, int top) {
    const int first = std::max(left - 1, 0), last = std::min(left + kCell + 1, width);
    const auto inRow = [&](int y) {
      return cover(static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                       static_cast<std::size_t>(first),
                   static_cast<std::size_t>(last - first));
    };
    int y = std::max(top - 1, 0);
    const Cover found = inRow(y);
    for (++y; y < std::min(top + kCell + 1, height) && found != Cover::kSome; ++y) {
      if (inRow(y) != found) return Cover::kSome;
    }
    return found;
  };
  const int columns = (width + kCell - 1) / kCell, rows = (height + kCell - 1) / kCell;
  std::vector<Cover> inside(std::size_t(rows) * std::size_t(columns));
  inParts(team, std::size_t(rows), [&](std::size_t row) {
    for (int column = 0; column < columns; ++column) {
      inside[row * std::size_t(columns) + std::size_t(column)] =
          coverAt(kCell * column, kCell * int(row));
    }
  });
  Cells cells;
  for (int row = -1; row <= rows; ++row) {
    for (int column = -1; column <= columns; ++column) {
      cells.push_back(inside[static_cast<std::size_t>(std::clamp(row, 0, rows - 1) * columns +
                                                      std::clamp(column, 0, columns - 1))]);
    }
  }
  return cells;
}

}  // namespace rosplat
