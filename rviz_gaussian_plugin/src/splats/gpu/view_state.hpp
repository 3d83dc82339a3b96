#pragma once

#include <cstddef>
#include <functional>

#include "gl/buffer.hpp"
#include "gl/depth.hpp"
#include "gl/shaders.hpp"
#include "gl/stopwatch.hpp"
#include "gl/target.hpp"
#include "gpu/frame.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"
#include "gpu/tile_rasterizer.hpp"

namespace rosplat {

// What is kept of a view from picture to picture: its targets, and the splats that it sees,
// projected, sorted and listed by tiles, so that none of this is done again until the view changes.
//
// A frame is submitted stage by stage with as much room as earlier frames have needed:
// prepare(), maybe list(), then blend() or inRegions(), then checkRoom(), and all of it again if
// that returns false.
class ViewState {
 public:
  // sort: may be shared with other objects.
  ViewState(Shaders& shaders, RadixSort& sort);

  // Makes later shaders draw the view of the last frame.
  void use() const { glBindBufferBase(GL_UNIFORM_BUFFER, 0, block_.id()); }
  // Begins a frame. Submits the projection and the sort of the splats, unless kept.
  void prepare(const Frame& frame);
  // Submits the lists by tiles, unless kept or made region by region: then inRegions() does.
  void list(gl::Stopwatch& stopwatch);
  // Submits the lists by tiles, unless there are any, and calls draw() after them. Where the lists
  // of all tiles would take too much memory, does both region by region.
  void inRegions(gl::Stopwatch& stopwatch, const std::function<void()>& draw);
  // Submits the blending of the splats that the depth of `color` lets pass into `color`. divided:
  // `behind` gets the splats that the depth of `color` hides and its own doesn't.
  void blend(gl::Stopwatch& stopwatch, bool divided);
  // Blends depths of a frame of these into a target instead: see TileRasterizer. Waits for the
  // lists' counts.
  void blendDepth(PictureDepth depth, const gl::Target& target);
  // Returns whether there was room for all that was submitted; else makes room. Waits only for the
  // counts, which the graphics card finds first.
  bool checkRoom();

  const OrderedSplats& splats() const { return splats_; }
  const TileRasterizer& tiles() const { return tiles_; }
  bool topFirst() const { return top_first_; }  // of the last frame
  std::size_t bytes() const;

  gl::Target color, behind;      // of the splats before and behind the translucent objects
  gl::SampledDepth translucent;  // of the nearest translucent objects
  bool open = false;             // the depth of `color` hides nothing

 private:
  void list(std::size_t region, gl::Stopwatch& stopwatch);
  bool checkRoomForLists(double growth);

  Tallies tallies_;
  OrderedSplats splats_;
  TileRasterizer tiles_;
  gl::Buffer block_;
  double growth_ = 1;           // of the maps of the last frame
  bool reported_ = false;       // counts are reported, and checkRoom() is to read them
  bool listed_ = false;         // splats were listed by tiles in this frame
  int width_ = 0, height_ = 0;  // of the last frame [px]
  bool top_first_ = false;
};

}  // namespace rosplat
