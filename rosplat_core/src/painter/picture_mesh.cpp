#include "rosplat_core/painter/picture_mesh.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <utility>

#include "raster/kernels.hpp"

namespace rosplat {

namespace {

static_assert(PictureMesh::kCell == kTile, "SplatPicture has a sum for each cell");

int cellsIn(int pixels) { return (pixels + PictureMesh::kCell - 1) / PictureMesh::kCell; }

// Fills the gaps of a grid, values of weight 0, with the mean of the neighbours that have a weight,
// ring by ring.
void fillGaps(std::vector<float>& values, std::vector<float>& weights, int columns, int rows) {
  const auto forNeighbours = [&](int place, const auto& each) {
    const int row = place / columns, column = place % columns;
    for (int r = std::max(row - 1, 0); r <= std::min(row + 1, rows - 1); ++r) {
      for (int c = std::max(column - 1, 0); c <= std::min(column + 1, columns - 1); ++c) {
        each(r * columns + c);
      }
    }
  };
  constexpr float kListed = -1;  // weight of a gap in `gaps`
  std::vector<int> gaps;         // that may have such a neighbour
  for (int place = 0; place < rows * columns; ++place) {
    if (weights[std::size_t(place)] == 0) gaps.push_back(place);
  }
  std::vector<std::pair<int, float>> filled;
  while (!gaps.empty()) {
    filled.clear();
    for (const int gap : gaps) {
      float sum = 0;
      int found = 0;
      forNeighbours(gap, [&](int place) {
        if (!(weights[std::size_t(place)] > 0)) return;
        sum += values[std::size_t(place)];
        ++found;
      });
      if (found) filled.emplace_back(gap, sum / static_cast<float>(found));
    }
    for (const auto& [gap, value] : filled) {
      values[std::size_t(gap)] = value;
      weights[std::size_t(gap)] = 1;
    }
    gaps.clear();
    for (const auto& [gap, value] : filled) {
      forNeighbours(gap, [&](int place) {
        if (weights[std::size_t(place)] != 0) return;
        weights[std::size_t(place)] = kListed;
        gaps.push_back(place);
      });
    }
  }
}

}  // namespace

PictureMesh::PictureMesh(const SplatCamera& camera, const SplatPicture& picture)
    : camera_(camera), columns_(cellsIn(camera.width) + 1), rows_(cellsIn(camera.height) + 1) {
  const auto corners = static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_);
  depths_.assign(corners, 0.0f);
  std::vector<float> weights(corners, 0.0f);
  for (std::size_t cell = 0; cell < picture.tiles.size(); ++cell) {
    const std::size_t row = cell / std::size_t(columns_ - 1);
    for (const int corner : {0, 1, columns_, columns_ + 1}) {
      depths_[cell + row + std::size_t(corner)] += picture.tiles[cell].depth;
      weights[cell + row + std::size_t(corner)] += picture.tiles[cell].alpha;
    }
  }
  for (std::size_t i = 0; i < corners; ++i) {
    if (weights[i] > 0) depths_[i] /= weights[i];
  }
  fillGaps(depths_, weights, columns_, rows_);
}

PictureMesh::CornerGrid PictureMesh::seenBy(const SplatCamera& camera) const {
  const auto [turn, shift] = frameIn(camera_, camera);
  // Position of corner number i of count [px]; -1 and count are beyond the picture.
  const auto place = [](int i, int count, int size) -> double {
    if (i < 0) return -0.5 * size;
    return i < count ? std::min(kCell * i, size) : 1.5 * size;
  };
  CornerGrid view{static_cast<std::size_t>(columns_ + 2), {}, !(camera == camera_)};
  view.corners.reserve(view.columns * static_cast<std::size_t>(rows_ + 2));
  for (int row = -1; row <= rows_; ++row) {
    for (int column = -1; column <= columns_; ++column) {
      const double u = place(column, columns_, camera_.width);
      const double v = place(row, rows_, camera_.height);
      const double depth = depths_[static_cast<std::size_t>(
          std::clamp(row, 0, rows_ - 1) * columns_ + std::clamp(column, 0, columns_ - 1))];
      // For perspective cameras the point divided by its depth: at infinity it stays a direction.
      std::array<double, 3> p{(u - camera_.cx) / camera_.fx, (v - camera_.cy) / camera_.fy,
                              camera_.orthographic ? depth : 1.0};
      const double weight = camera_.orthographic ? 1.0 : depth;
      std::array<double, 3> q{};
      for (int i = 0; i < 3; ++i) {
        q[i] = weight * shift[i];
        for (int k = 0; k < 3; ++k) q[i] += turn[3 * i + k] * p[k];
      }
      const double w = camera.orthographic ? std::max(weight, 1e-12) : q[2];
      const double x = camera.fx * q[0] + camera.cx * w, y = camera.fy * q[1] + camera.cy * w;
      view.corners.push_back({static_cast<float>(2 * x / camera.width - w),
                              static_cast<float>(w - 2 * y / camera.height), static_cast<float>(w),
                              static_cast<float>(u / camera_.width),
                              static_cast<float>(v / camera_.height)});
    }
  }
  return view;
}

}  // namespace rosplat
