#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/raster.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Draws ordered splats in compute shaders (Kerbl et al. 2023): lists them by tiles of the picture,
// then blends each pixel front to back in 32-bit floats and stops where nothing more can be seen.
class TileRasterizer {
 public:
  // The sort may be one that others use too.
  TileRasterizer(const Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Counts the pairs of a splat and a tile of the target that it touches; false where there is no
  // memory to list them, which is refused() then, and so are as many from now on.
  bool count(const OrderedSplats& splats, const gl::Target& target, gl::Stopwatch& stopwatch);
  // Lists what was counted; of more pairs than there is room for, the last are left out.
  void list(const OrderedSplats& splats, const gl::Target& target, gl::Stopwatch& stopwatch);
  // Whether what was listed last is for a target like this.
  bool listed(const gl::Target& target) const { return listed_ && counted(target); }

  // What is listed: indices of ellipses, tile by tile, nearest first; where each tile's begin.
  void bindLists(GLuint splats, GLuint begins) const {
    sort_.values().bind(splats);
    begins_.bind(begins);
  }

  // Overwrites the target's colour by what is listed, where its depth lets a splat pass; `behind`,
  // if there is one, gets those that the target's depth hides and its own lets pass, and in its
  // second colour their nearness, as splat_hide.frag reads it.
  void blend(const OrderedSplats& splats, const gl::Target& target, const gl::Target* behind,
             const Raster& raster) const;

  // Makes room for so many pairs, better for more; false where that takes too much memory.
  bool reserve(std::size_t pairs, std::size_t better);
  std::size_t room() const { return room_; }
  // Whether reserve() refused last, so that the next ones should be counted before they are listed;
  // and whether it was for these splats and a target like this.
  bool refused() const { return refused_; }
  bool refused(const gl::Target& target) const { return refused_ && counted(target); }

  // The splats or their order aren't those of the last draw() any more.
  void forget() {
    counted_width_ = 0;
    listed_ = false;
  }

  std::size_t bytes() const;

 private:
  bool counted(const gl::Target& target) const;

  gl::Program count_, list_, ranges_, blend_, blend_divided_;
  PrefixSum prefix_sum_;
  RadixSort& sort_;
  Tally pair_count_;
  gl::Slice zero_;
  gl::Buffer begins_;
  std::size_t most_pairs_, room_ = 0;
  int counted_width_ = 0, counted_height_ = 0;  // the picture that pairs were counted for [px]
  bool listed_ = false, refused_ = false;
};

}  // namespace rosplat
