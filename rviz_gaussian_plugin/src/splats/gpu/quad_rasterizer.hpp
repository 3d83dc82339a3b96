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

  // Overwrites the target's colour with the splats that its depth lets pass. scope: the target's.
  // `behind`, if not null, gets the splats that the target's depth hides and its own depth lets
  // pass; its second colour gets their nearness, as splat_hide.frag reads it.
  void blend(const OrderedSplats& splats, const gl::Target& target, const gl::DrawScope& scope,
             const gl::Target* behind);
  // Overwrites the bound target's colour with the splats' depth [m] times alpha, and with alpha.
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
