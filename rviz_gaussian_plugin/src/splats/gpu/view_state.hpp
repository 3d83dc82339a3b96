#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/frame.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/quad_rasterizer.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"
#include "gpu/tile_rasterizer.hpp"

namespace rosplat {

// What is kept of a view from picture to picture: its targets, and what it sees, projected, sorted
// and listed by tiles, so that nothing of it is done again until it changes.
//
// A frame is submitted stage by stage with as much room as earlier frames have needed:
// prepare(), then blend() or list(), then hasRoom(), and all of it again where that says so.
class ViewState {
 public:
  // The sort may be one that others use too.
  ViewState(Shaders& shaders, RadixSort& sort);

  // Has the shaders that come next draw what was drawn last.
  void use() const { glBindBufferBase(GL_UNIFORM_BUFFER, 0, block_.id()); }
  // Submits what projects and sorts what is visible, unless that is there; begins a frame.
  void prepare(const Frame& frame);
  // Submits what lists it by tiles, unless that is there; false where there is no memory for it.
  bool list(const Frame& frame);
  // Submits what blends the splats into `color`, whose scope this is, in_tiles where there is
  // memory for their lists, hidden by its depth; and into `behind`, if divided, those that the
  // depth of `color` hides and its own doesn't.
  void blend(const Frame& frame, const gl::DrawScope& scope, bool in_tiles, bool divided);
  // Whether there was room for all that was submitted; else makes it. Waits for no more than what
  // the graphics card counts first.
  bool hasRoom(const Frame& frame);

  const OrderedSplats& splats() const { return splats_; }
  const TileRasterizer& tiles() const { return tiles_; }
  const QuadRasterizer& quads() const { return quads_; }
  const char* rasterizer() const { return rasterizer_; }  // of the last blend()
  bool topFirst() const { return top_first_; }            // of the last frame
  std::size_t bytes() const;

  gl::Target color, behind;      // of the splats before and behind what divides them
  gl::SampledDepth translucent;  // of the nearest translucent objects
  bool open = false;             // the depth of `color` hides nothing

 private:
  void ask();

  Tallies tallies_;
  OrderedSplats splats_;
  TileRasterizer tiles_;
  QuadRasterizer quads_;
  gl::Buffer block_;
  bool unknown_ = false;  // what was submitted isn't counted yet
  bool asked_ = false;    // for what was counted
  bool listed_ = false;   // by tiles, in this frame
  const char* rasterizer_ = "";
  bool top_first_ = false;
};

}  // namespace rosplat
