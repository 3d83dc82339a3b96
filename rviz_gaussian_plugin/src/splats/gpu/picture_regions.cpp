#include "gpu/picture_regions.hpp"

#include <algorithm>

namespace rosplat {

namespace {

// How often a number of rows or columns can be halved until each is alone.
int halvings(int count) { return count > 1 ? 1 + halvings((count + 1) / 2) : 0; }

// Where a part of 2^halved parts begins.
int cut(int count, std::size_t part, int halved) {
  return static_cast<int>(static_cast<std::size_t>(count) * part >> halved);
}

}  // namespace

void PictureRegions::begin(std::size_t number, int columns, int rows) {
  if (number == 0) {
    if (count_ > 1 && fitting_ == count_ / 2) count_ /= 2;
    fitting_ = 0;
  }
  columns_ = columns;
  rows_ = rows;
  count_ = std::min(count_, most());
  number_ = number;
  int down = 0, across = 0;  // halvings of rows, and of columns
  for (std::size_t parts = count_; parts > 1; parts /= 2) ++(down < halvings(rows) ? down : across);
  const std::size_t row = number >> across, column = number - (row << across);
  region_ = {cut(columns, column, across), cut(rows, row, down), cut(columns, column + 1, across),
             cut(rows, row + 1, down)};
}

bool PictureRegions::split(std::size_t times) {
  if (count_ >= most()) return false;
  for (; times > 1 && count_ < most(); times = (times + 1) / 2) count_ *= 2;
  fitting_ = 0;
  return true;
}

std::size_t PictureRegions::most() const {
  return std::size_t{1} << (halvings(columns_) + halvings(rows_));
}

}  // namespace rosplat
