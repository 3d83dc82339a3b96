#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/group_sums.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Draws ordered splats in compute shaders (Kerbl et al. 2023): lists them by tiles of the picture,
// then blends each pixel front to back in 32-bit floats and stops where nothing more can be seen.
class TileRasterizer {
 public:
  // The sort may be one that others use too.
  TileRasterizer(Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Counts the pairs of a splat and a tile that it touches, of a picture of such a size; false
  // where there is no memory to list them, which is refused() then.
  bool count(const OrderedSplats& splats, int width, int height);
  // Lists what was counted; of more pairs than there is room for, the last are left out.
  void list(const OrderedSplats& splats, gl::Stopwatch& stopwatch);
  // Whether what was listed last is for a picture of this size.
  bool listed(int width, int height) const { return listed_ && counted(width, height); }

  // What is listed: indices of ellipses, tile by tile, nearest first; where each tile's begin.
  const gl::Buffer& splats() const { return splats_; }
  const gl::Buffer& begins() const { return begins_; }

  // Overwrites the target's colour by what is listed, where its depth lets a splat pass; `behind`,
  // if there is one, gets those that the target's depth hides and its own lets pass, and in its
  // second colour their nearness, as splat_hide.frag reads it.
  void blend(const OrderedSplats& splats, const gl::Target& target, const gl::Target* behind);

  // Whether there was room for so many pairs; else makes it, better for more by a factor, or, where
  // that takes too much memory, refuses.
  bool checkRoom(std::size_t pairs, double growth);
  // Whether too many were refused last, so that the next ones should be counted before they are
  // listed; and whether it was these, for a picture of this size.
  bool refused() const { return refused_; }
  bool refused(int width, int height) const { return refused_ && counted(width, height); }

  // The splats or their order aren't those of the last picture any more.
  void forget() {
    width_ = 0;
    listed_ = false;
  }

  std::size_t bytes() const;

 private:
  std::size_t tiles() const { return std::size_t(tilesIn(width_)) * std::size_t(tilesIn(height_)); }
  bool counted(int width, int height) const { return width_ == width && height_ == height; }

  void useSegments(const gl::Program& program) const;

  const gl::Program &count_, &list_, &ranges_, &composite_;
  const gl::Program &blend_, &blend_balls_, &blend_divided_, &blend_shares_, &blend_shares_divided_;
  PrefixSum prefix_sum_;
  RadixSort& sort_;
  Tally pair_count_;
  gl::Slice zero_;
  gl::Buffer splats_, begins_, counts_;
  gl::Buffer segments_;                      // as tile_segments.glsl has it
  GLuint later_segment_ = 0, most_cut_ = 0;  // the same
  std::size_t room_ = 0;
  UsageTracker used_;
  std::size_t most_pairs_;      // that may be listed
  int out_of_memory_ = 0;       // counts to come until more than half of what failed is tried again
  int width_ = 0, height_ = 0;  // of the picture that pairs were counted for [px]
  bool listed_ = false, refused_ = false;
};

}  // namespace rosplat
