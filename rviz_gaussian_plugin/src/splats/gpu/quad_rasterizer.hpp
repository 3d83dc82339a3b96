#pragma once

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/ordered_splats.hpp"

namespace rosplat {

// Draws ordered splats as quads as large as their ellipses, which fixed function blends back to
// front.
class QuadRasterizer {
 public:
  explicit QuadRasterizer(Shaders& shaders);

  // Overwrites the colour of a target, whose scope this is, where its depth lets a splat pass;
  // `behind`, if there is one, gets those that the target's depth hides and its own lets pass, and
  // in its second colour their nearness, as splat_hide.frag reads it.
  void blend(const OrderedSplats& splats, const gl::Target& target, const gl::DrawScope& scope,
             const gl::Target* behind);
  // Overwrites the colour of the target that is bound by depth [m] and how much there is, instead.
  void blendDepth(const OrderedSplats& splats, const gl::Target& target) const;

  std::size_t bytes() const;

 private:
  // What quads are drawn for.
  enum class Quads { kColour, kDepth, kBehind };

  void divide(const OrderedSplats& splats, const gl::Target& target, const gl::Target& behind);
  void draw(const OrderedSplats& splats, const gl::Buffer& drawn, const gl::Target& target,
            Quads what) const;

  const gl::Program &quads_, &quads_behind_, &tile_depth_, &divide_;
  gl::Target tile_depths_;  // nearest and farthest depth that divides the splats in a tile
  gl::Buffer drawn_before_, drawn_behind_;  // like drawn(), kNone where a splat can't be seen there
};

}  // namespace rosplat
