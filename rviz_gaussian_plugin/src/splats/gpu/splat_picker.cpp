#include "gpu/splat_picker.hpp"

#include <vector>

namespace rosplat {

SplatPicker::SplatPicker(Shaders& shaders)
    : pick_(shaders,
            {"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl", "splat_pick.comp"}),
      colour_(shaders.draw({"splat_composite.vert"}, {"splat_pick.frag"})) {}

void SplatPicker::begin(const OrderedSplats& splats, const gl::Target& target, bool top_first) {
  width_ = static_cast<std::size_t>(target.width());
  height_ = static_cast<std::size_t>(target.height());
  top_first_ = top_first;
  const std::vector<std::uint32_t> nothing(width_ * height_, kNoSlot);
  first_slots_ = splats.projection().pages().firstSlots();
  layer_begins_ = splats.projection().pages().layerBegins();
  picked_.reserve(nothing.size() * sizeof(std::uint32_t));
  picked_.write(0, nothing.data(), nothing.size() * sizeof(std::uint32_t));
}

void SplatPicker::pick(const OrderedSplats& splats, const TileRasterizer& lists,
                       const gl::Target& target) {
  const gl::Program& program = pick_.of(splats.projection().shapes());
  program.use();
  splats.projection().bindEllipses(program);
  program.bind("Picked", picked_);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.depth());
  lists.dispatchTiles(program);
  gl::storageBarrier();
}

void SplatPicker::draw(const CanvasScope& canvas, const gl::Target& target,
                       std::uint32_t number) const {
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  colour_.use();
  colour_.set("width", target.width());
  colour_.set("number", number);
  colour_.bind("Picked", picked_);
  canvas.layOver(colour_, target);
}

std::vector<std::uint32_t> SplatPicker::read(std::size_t layer) const {
  std::vector<std::uint32_t> slots(width_ * height_);
  for (std::size_t i = 0; i < height_; ++i) {
    const std::size_t row = top_first_ ? i : height_ - 1 - i;
    picked_.read(row * width_ * sizeof(std::uint32_t), &slots[i * width_],
                 width_ * sizeof(std::uint32_t));
  }
  for (std::uint32_t& slot : slots) {
    if (slot == kNoSlot) continue;
    const std::size_t page = slot / SlotPage::kSlots;
    const bool mine = page >= layer_begins_[layer] && page < layer_begins_[layer + 1];
    slot = mine ? first_slots_[page] + slot % SlotPage::kSlots : kNoSlot;
  }
  return slots;
}

}  // namespace rosplat
