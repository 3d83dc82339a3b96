#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/group_sums.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Draws ordered splats in compute shaders: lists them by macro tiles of the picture, finds which of
// their tiles each touches (as HiGS does, arXiv 2606.00352), then blends each pixel of a tile front
// to back in 32-bit floats and stops where nothing more can be seen (Kerbl et al. 2023).
class TileRasterizer {
 public:
  // sort: may be shared with other objects.
  TileRasterizer(Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Counts the pairs of a splat and a macro tile that it touches, in a picture of this size [px].
  // Returns false, and is refused(), if there is no memory to list them.
  bool count(const OrderedSplats& splats, int width, int height);
  // Lists the pairs that were counted, and the splats that touch each tile. If there is no room for
  // all, some are left out.
  void list(const OrderedSplats& splats, gl::Stopwatch& stopwatch);
  // Whether the last lists are for a picture of this size.
  bool listed(int width, int height) const { return listed_ && counted(width, height); }

  // The tiles' lists, as splat_tiles.glsl has them, and the indices of ellipses in them.
  const gl::Buffer& lists() const { return lists_; }
  const gl::Buffer& splats() const { return listed_splats_; }

  // Overwrites the target's colour with the listed splats that its depth lets pass. `behind`, if
  // not null, gets the splats that the target's depth hides and its own depth lets pass; its second
  // colour gets their nearness, as splat_hide.frag reads it.
  void blend(const OrderedSplats& splats, const gl::Target& target, const gl::Target* behind);

  // Returns whether there was room for so many pairs of a splat and a macro tile. Else has the next
  // count() make room, for more by the factor `growth` if possible, or refuses if they take too
  // much memory.
  bool checkRoom(std::size_t macro_pairs, double growth);
  // The same for pairs of a splat and a tile, and for segments of long lists. If segments take too
  // much, some lists are blended whole.
  bool checkLists(std::size_t pairs, std::size_t segments, double growth);
  // Whether pairs were refused last: then wait for the next count before listing. With a size:
  // whether the pairs of a picture of this size were refused.
  bool refused() const { return refused_; }
  bool refused(int width, int height) const { return refused_ && counted(width, height); }

  // Tells that the splats or their order have changed since the last picture.
  void forget() {
    width_ = 0;
    listed_ = false;
  }

  std::size_t bytes() const;

 private:
  std::size_t tiles() const { return std::size_t(tilesIn(width_)) * std::size_t(tilesIn(height_)); }
  std::size_t macroTiles() const;
  bool counted(int width, int height) const { return width_ == width && height_ == height; }

  void reserve(std::size_t splats);
  void bindTouching(const gl::Program& program) const;

  const gl::Program &count_, &list_macros_, &touch_, &place_, &list_, &composite_;
  const gl::Program &blend_, &blend_balls_, &blend_divided_, &blend_shares_, &blend_shares_divided_;
  PrefixSum prefix_sum_;
  RadixSort& sort_;
  Tally macro_pair_count_;
  gl::Slice zero_, wanted_;
  gl::Buffer counts_;
  gl::Buffer splats_, begins_, places_;  // as tile_touching.glsl and tile_places.comp have them
  gl::Buffer listed_splats_, lists_;
  gl::Buffer segments_, partials_;  // as tile_segments.glsl has them
  std::size_t macro_room_ = 0, room_ = 0, segments_room_;
  UsageTracker macro_used_, used_, segments_used_;
  std::size_t most_macro_pairs_;  // more are refused
  int patience_ = 0;              // calls of count() until more than half of what failed is tried
  int width_ = 0, height_ = 0;    // of the picture that pairs were counted for [px]
  bool listed_ = false, refused_ = false;
};

}  // namespace rosplat
