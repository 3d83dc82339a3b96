#include "gpu/quad_rasterizer.hpp"

#include <array>

#include "gl/canvas.hpp"

namespace rosplat {

QuadRasterizer::QuadRasterizer(Shaders& shaders)
    : quads_(shaders.draw(
          {"splat_ellipses.glsl", "splat_depth.glsl", "splat_colour.glsl", "splat_quad.vert"},
          {"splat_quad.frag"})),
      quads_behind_(shaders.draw(
          {"splat_ellipses.glsl", "splat_depth.glsl", "splat_colour.glsl", "splat_quad.vert"},
          {"splat_behind.glsl", "splat_quad.frag"})),
      tile_depth_(shaders.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "tile_depth.comp"})),
      divide_(shaders.compute(
          {"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl", "splat_divide.comp"})) {}

void QuadRasterizer::blend(const OrderedSplats& splats, const gl::Target& target,
                           const gl::DrawScope& scope, const gl::Target* behind) {
  if (behind) {
    divide(splats, target, *behind);
    const gl::DrawScope behind_scope(*behind, target);
    glActiveTexture(GL_TEXTURE0);
    glBindTexture(GL_TEXTURE_2D, behind->depth());
    draw(splats, drawn_behind_, *behind, Quads::kBehind);
    scope.bind();
  }
  draw(splats, behind ? drawn_before_ : splats.drawn(), target, Quads::kColour);
}

void QuadRasterizer::blendDepth(const OrderedSplats& splats, const gl::Target& target) const {
  draw(splats, splats.drawn(), target, Quads::kDepth);
}

// Lists the splats that any tile may show before the translucent objects, and those behind them.
void QuadRasterizer::divide(const OrderedSplats& splats, const gl::Target& target,
                            const gl::Target& behind) {
  const int across = tilesIn(target.width()), down = tilesIn(target.height());
  tile_depths_.become(GL_RG32F, across, down);
  tile_depth_.use();
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, behind.depth());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.depth());
  glBindImageTexture(0, tile_depths_.color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RG32F);
  gl::dispatch(std::size_t(across) * std::size_t(down));
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT);

  drawn_before_.reserve(splats.drawn().bytes());
  drawn_behind_.reserve(splats.drawn().bytes());
  divide_.use();
  splats.projection().bindEllipses(divide_);
  glBindTexture(GL_TEXTURE_2D, tile_depths_.color());
  divide_.bind("Drawn", splats.drawn());
  divide_.bind("DrawnBefore", drawn_before_);
  divide_.bind("DrawnBehind", drawn_behind_);
  divide_.bind("Length", splats.tally().words());
  splats.tally().dispatchGroups();
  gl::storageBarrier();
}

void QuadRasterizer::draw(const OrderedSplats& splats, const gl::Buffer& drawn,
                          const gl::Target& target, Quads what) const {
  glViewport(0, 0, target.width(), target.height());
  const std::array<float, 4> nothing{};
  glClearBufferfv(GL_COLOR, 0, nothing.data());
  if (target.second()) glClearBufferfv(GL_COLOR, 1, nothing.data());
  blendOver();
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(what == Quads::kBehind ? GL_GREATER : GL_LEQUAL);
  glDepthMask(GL_FALSE);
  const gl::Program& program = what == Quads::kBehind ? quads_behind_ : quads_;
  program.use();
  program.set("raw_depth", int(what == Quads::kDepth));
  splats.projection().bindEllipses(program);
  program.bind("Drawn", drawn);
  program.bind("DepthRange", splats.projection().depthRange());
  program.bind("Shares", splats.projection().shares());
  program.bind("Length", splats.tally().words());
  splats.tally().drawQuads();
}

std::size_t QuadRasterizer::bytes() const {
  return tile_depths_.bytes() + drawn_before_.bytes() + drawn_behind_.bytes();
}

}  // namespace rosplat
