#pragma once

#include <array>
#include <cstddef>

namespace rosplat {

// The regions that a picture is listed in, one after the other, where the lists of all its macro
// tiles find no room. Their number is a power of two: rows of macro tiles are halved until each is
// alone, then columns. So each region is half of one of half as many regions.
class PictureRegions {
 public:
  // The first column and row of macro tiles, and one past the last.
  using Region = std::array<int, 4>;

  // Begins a region of a picture of so many macro tiles. Before the first one, there become half as
  // many regions if all neighbours fitted in the picture before.
  void begin(std::size_t number, int columns, int rows);
  // Notes that the region, of an odd number, and the one before it would find room together.
  void noteFit() { ++fitting_; }
  // Makes so many times as many regions, or more. Returns false if there are no smaller ones.
  bool split(std::size_t times);

  std::size_t count() const { return count_; }
  std::size_t number() const { return number_; }    // of the region that was begun
  const Region& region() const { return region_; }  // may be empty

 private:
  std::size_t most() const;

  std::size_t count_ = 1, number_ = 0;
  std::size_t fitting_ = 0;  // pairs of neighbours, in this picture
  int columns_ = 1, rows_ = 1;
  Region region_{};
};

}  // namespace rosplat
