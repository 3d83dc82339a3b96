#pragma once

#include <cstddef>
#include <functional>

#include "gl_objects.hpp"
#include "ordered_splats.hpp"
#include "radix_sort.hpp"
#include "raster.hpp"
#include "shaders.hpp"
#include "tally.hpp"

namespace rosplat {

// Draws ordered splats in compute shaders (Kerbl et al. 2023): lists them by tiles of the picture,
// then blends each pixel front to back in 32-bit floats and stops where nothing more can be seen.
class TileRasterizer {
 public:
  // The sort may be one that others use too.
  TileRasterizer(const Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Lists splats by tiles; of more pairs than there is room for, the last are left out. `counted`
  // is called as soon as all is submitted that tells how many there are.
  void list(const OrderedSplats& splats, const gl::Target& target, gl::Stopwatch& stopwatch,
            const std::function<void()>& counted);
  // Whether what was listed last is for a target like this.
  bool listed(const gl::Target& target) const;

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

  // Makes room for so many pairs of a splat and a tile that it touches, better for more; false
  // where that takes too much memory.
  bool reserve(std::size_t pairs, std::size_t better);
  std::size_t room() const { return room_; }

  // The splats or their order aren't those of the last draw() any more.
  void forget() { listed_width_ = 0; }

  std::size_t bytes() const;

 private:
  gl::Program count_, list_, ranges_, blend_, blend_divided_;
  PrefixSum prefix_sum_;
  RadixSort& sort_;
  Tally pair_count_;
  gl::Slice zero_;
  gl::Buffer begins_;
  std::size_t most_pairs_, room_ = 0;
  int listed_width_ = 0, listed_height_ = 0;  // the picture that the lists are for [px]
};

}  // namespace rosplat
