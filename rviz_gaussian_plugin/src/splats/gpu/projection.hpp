#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gl/readback.hpp"
#include "gl/shaders.hpp"
#include "gpu/frame.hpp"
#include "gpu/page_table.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Finds the slots of maps that the camera may see, and projects them to ellipses. An ellipse has
// the number of its slot, as page_table.hpp numbers those of the pages in view: what isn't seen
// leaves a gap. Only the graphics card knows how many are seen.
class Projection {
 public:
  Projection(Shaders& shaders, const Tallies& tallies);

  // Finds the pages in view, and makes room for all of their slots: slots(). growth: by how much a
  // map is expected to grow. Throws gl::Error where the driver has no room.
  void prepare(const Frame& frame, double growth);
  std::size_t slots() const { return pages_.count() * SlotPage::kSlots; }
  std::size_t room() const { return room_; }  // for slots

  // Submits the projection. keys: gets the depth key of each slot, kNone of those that aren't seen.
  void run(const Frame& frame, const gl::Buffer& keys);

  const gl::Slice& seen() const { return seen_; }  // a SeenTally
  Shapes shapes() const { return shapes_; }
  // Returns how many of all `seen` splats are of each layer. With several, waits for the counts.
  std::vector<std::size_t> ofLayers(std::size_t seen) const;
  // Binds the buffers of splat_ellipses.glsl.
  void bindEllipses(const gl::Program& program) const;
  const PageTable& pages() const { return pages_; }
  const gl::Buffer& boxes() const { return boxes_; }    // as splat_tiles.glsl has them
  const gl::Buffer& planes() const { return planes_; }  // of a frame of depths
  // Whether nodes stand for some splats. If so, shares() are the drawn shares, else anything.
  bool hasShares() const { return shares_begin_ > 0; }
  gl::Slice shares() const { return {boxes_.id(), shares_begin_, boxes_.bytes() - shares_begin_}; }
  std::size_t bytes() const;

 private:
  void reserve(std::size_t slots, bool shares);
  void release();

  PageTable pages_;
  Shaders& shaders_;
  ShapedProgram project_, project_depths_;
  Shapes shapes_ = Shapes::kEllipses;
  gl::Buffer groups_, maps_;  // as splat_groups.glsl and splat_map.glsl have them
  gl::Buffer of_layers_;      // with several layers: how many splats are seen of each
  std::optional<gl::Readback> of_layers_copy_;
  std::array<gl::Buffer, Shaders::kEllipseParts> ellipses_;
  gl::Buffer boxes_, planes_;
  std::size_t shares_begin_ = 0;  // in `boxes_` [bytes]; 0: no shares
  gl::Slice seen_;
  std::size_t room_ = 0;
  UsageTracker used_;  // of that room
};

}  // namespace rosplat
