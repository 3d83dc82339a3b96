#pragma once

#include <cstddef>

#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gl/shaders.hpp"
#include "gl/stopwatch.hpp"
#include "gl/target.hpp"
#include "gpu/group_counts.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/picture_regions.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"
#include "rosplat_core/raster/picture_depth.hpp"

namespace rosplat {

// Draws ordered splats in compute shaders: lists them by macro tiles of the picture, finds which of
// their tiles each touches (as HiGS does, arXiv 2606.00352), then blends each pixel of a tile front
// to back in 32-bit floats and stops where nothing more can be seen (Kerbl et al. 2023).
class TileRasterizer {
 public:
  // sort: may be shared with other objects; between sorts, lists use its memory.
  TileRasterizer(Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Lists the splats that touch each tile of a region. If there is no room for all, some are left
  // out: see checkRoom(). Throws gl::Error if there is no memory for any.
  void list(const OrderedSplats& splats, int width, int height, std::size_t region,
            gl::Stopwatch& stopwatch);
  // How many regions a picture is listed in, one after the other: one, if there is room for its
  // lists.
  std::size_t regions() const { return regions_.count(); }
  // Whether the last lists are those of a whole picture of this size.
  bool listed(int width, int height) const {
    return listed_ && width_ == width && height_ == height;
  }

  // Bind the lists to a program. Run it, a work group for each tile of the listed region.
  void dispatchTiles(const gl::Program& program) const;

  // Overwrites the target's colour in the listed region with the splats that its depth lets pass.
  // `behind`, if not null, gets the splats that the target's depth hides and its own depth lets
  // pass; its second colour gets their nearness, as splat_hide.frag reads it.
  void blend(const OrderedSplats& splats, const gl::Target& target, const gl::Target* behind);
  // The same, but red gets the splats' mean depth times alpha, or their median depth where alpha is
  // at least one half. [m]
  void blendDepth(const OrderedSplats& splats, PictureDepth depth, const gl::Target& target);

  // What the lists of a region would have with room for all: pairs of a splat and a macro tile, of
  // a splat and a tile, and segments of long lists.
  struct Wanted {
    std::size_t macro_pairs, pairs, segments;
  };
  // Returns whether the last lists had room for what was wanted. Else has later lists make room,
  // for more by the factor `growth` if possible, or in more regions. If segments take too much,
  // some lists are blended whole. If so does the smallest region, some splats are left out.
  bool checkRoom(const Wanted& wanted, double growth);

  // Whether some splats were left out of the last picture's lists, for lack of memory.
  bool leavesOut() const { return leaves_out_; }

  // Tells that the splats or their order have changed since the last picture.
  void forget() { listed_ = false; }

  std::size_t bytes() const;

 private:
  std::size_t tiles() const { return std::size_t(tilesIn(width_)) * std::size_t(tilesIn(height_)); }
  std::size_t macroTiles() const { return std::size_t(macroColumns()) * std::size_t(macroRows()); }
  int macroColumns() const;
  int macroRows() const;
  int macroBits() const;

  void reserve(const OrderedSplats& splats);
  void listMacroPairs(const OrderedSplats& splats);
  void listByTiles(const OrderedSplats& splats);
  void bindTouching(const gl::Program& program) const;
  void blendInSegments(const gl::Program& program, const OrderedSplats& splats,
                       const gl::Target& target);
  void blendTiles(const gl::Program& program, const OrderedSplats& splats,
                  const gl::Target& target) const;

  ShapedProgram count_, list_macros_, touch_;
  const gl::Program &place_, &list_, &composite_;
  ShapedProgram blend_, blend_balls_, blend_divided_, blend_shares_, blend_shares_divided_;
  ShapedProgram blend_depths_, blend_medians_;
  RadixSort& sort_;
  const Tallies& tallies_;
  gl::Slice macro_pairs_, wanted_;
  GroupCounts counts_;                   // of pairs of 32 splats and macro tiles
  gl::Buffer splats_, begins_, places_;  // as tile_touching.glsl and tile_places.comp have them
  gl::Buffer listed_splats_, lists_;
  gl::Buffer segments_, partials_;  // as tile_segments.glsl has them
  Wanted room_;                     // for the lists of a region
  std::size_t expected_ = 0;        // pairs of a splat and a macro tile, of the last lists
  Wanted most_;                     // what room_ may become
  UsageTracker macro_pairs_used_, pairs_used_, segments_used_;
  int patience_ = 0;            // lists until memory that was lacking is tried again
  int width_ = 0, height_ = 0;  // of the picture that is listed [px]
  bool listed_ = false;
  PictureRegions regions_;
  bool leaves_out_ = false;  // in this picture
  Wanted even_{};            // of the last region with an even number
};

}  // namespace rosplat
