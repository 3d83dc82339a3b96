#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/buffer.hpp"
#include "gl/canvas.hpp"
#include "gl/program.hpp"
#include "gl/shaders.hpp"
#include "gl/target.hpp"
#include "gpu/ordered_splats.hpp"
#include "gpu/tile_rasterizer.hpp"

namespace rosplat {

// Finds the splat that contributes most to each pixel, at least a twentieth of its colour.
class SplatPicker {
 public:
  explicit SplatPicker(Shaders& shaders);

  // Begins picks among the splats of a picture as large as the target.
  void begin(const OrderedSplats& splats, const gl::Target& target, bool top_first);
  // Picks in the region that is listed, where the target's depth doesn't hide splats.
  void pick(const OrderedSplats& splats, const TileRasterizer& lists, const gl::Target& target);
  // Writes a number as 24-bit colour wherever a splat was picked.
  void draw(const CanvasScope& canvas, const gl::Target& target, std::uint32_t number) const;
  // Returns the picked slots of a layer: width * height, top row first; kNoSlot for none.
  std::vector<std::uint32_t> read(std::size_t layer) const;

  std::size_t bytes() const { return picked_.bytes(); }

 private:
  ShapedProgram pick_;
  const gl::Program& colour_;
  gl::Buffer picked_;  // numbers of slots, as PageTable has them
  // PageTable::firstSlots() and layerBegins(), as begin() found them.
  std::vector<std::uint32_t> first_slots_;
  std::vector<std::size_t> layer_begins_;
  std::size_t width_ = 0, height_ = 0;
  bool top_first_ = false;
};

}  // namespace rosplat
