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
#include "gpu/group_counts.hpp"
#include "gpu/page_table.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Finds the slots of maps that may be visible to the camera, counts them, and projects them to
// ellipses, which lie one after the other, map by map in the order of their slots. Only the
// graphics card knows their number. If there is no room for all, the last ones are left out.
class Projection {
 public:
  Projection(Shaders& shaders, const Tallies& tallies);

  // What splats are projected to from now on.
  void prepare(Shapes shapes);
  Shapes shapes() const { return shapes_; }
  // Makes room for so many visible splats. Throws gl::Error where the driver has none.
  void reserve(std::size_t count);
  std::size_t room() const { return room_; }
  // Frees that room, and what is projected.
  void release();

  // Submits the projection. keys: gets the depth keys; has room for room() of them.
  void run(const Frame& frame, const gl::Buffer& keys);

  const gl::Slice& seen() const { return seen_; }  // a SeenTally
  // Returns how many of all `visible` splats each layer shows. With several, waits for the counts.
  std::vector<std::size_t> visibleOf(std::size_t visible) const;
  // Bind the buffers of splat_ellipses.glsl and splat_visible.glsl.
  void bindEllipses(const gl::Program& program) const;
  void bindVisible(const gl::Program& program) const;
  // Words of the bits that bindVisible() binds: a bit for each slot of pages().
  std::size_t slotWords() const { return pages_.count() * SlotPage::kSlots / 32; }
  const PageTable& pages() const { return pages_; }
  const gl::Buffer& boxes() const { return boxes_; }  // as splat_tiles.glsl has them
  // Whether nodes stand for some splats. If so, shares() are the drawn shares, else anything.
  bool hasShares() const { return shares_begin_ > 0; }
  gl::Slice shares() const { return {boxes_.id(), shares_begin_, boxes_.bytes() - shares_begin_}; }
  std::size_t bytes() const;

 private:
  void cull();
  void askForLayers();
  void project(const Frame& frame, const gl::Buffer& keys);
  void bindMap(const PageTable::Range& range) const;

  PageTable pages_;
  Shaders& shaders_;
  const gl::Program& cull_;
  ShapedProgram project_;
  Shapes shapes_ = Shapes::kEllipses;
  gl::Buffer groups_, maps_;  // as splat_groups.glsl and splat_map.glsl have them
  gl::Buffer visible_;
  GroupCounts counts_;  // of visible slots
  // With several layers: how many splats are visible in the layers before each.
  gl::Buffer visible_before_;
  std::optional<gl::Readback> visible_before_copy_;
  std::array<gl::Buffer, Shaders::kEllipseParts> ellipses_;
  gl::Buffer boxes_;
  std::size_t shares_begin_ = 0;  // in `boxes_` [bytes]; 0: no shares
  gl::Slice seen_;
  std::size_t room_ = 0;
};

}  // namespace rosplat
