#include "gpu/view_state.hpp"

#include <algorithm>

#include "gpu/view_block.hpp"

namespace rosplat {

ViewState::ViewState(Shaders& shaders, RadixSort& sort)
    : splats_(shaders, sort, tallies_),
      tiles_(shaders, sort, tallies_),
      quads_(shaders),
      block_(sizeof(ViewBlock), GL_DYNAMIC_DRAW) {}

void ViewState::prepare(const Frame& frame) {
  // The frame before may still read what this one writes.
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);
  const ViewBlock block(frame);
  block_.write(0, &block, sizeof(block));
  use();
  top_first_ = frame.top_first;
  if (splats_.answers(frame)) return;
  splats_.prepare(frame);
  tiles_.forget();
  unknown_ = true;
}

bool ViewState::list(const Frame& frame) {
  const int width = frame.camera().width, height = frame.camera().height;
  if (tiles_.refused(width, height)) return false;
  if (tiles_.listed(width, height)) return true;
  if (!tiles_.count(splats_, width, height)) return false;
  frame.stopwatch.lap("list");
  // After a refusal, waiting for the count costs less than listing in vain again.
  if (tiles_.refused()) {
    ask();
    if (!tiles_.checkRoom(tallies_.wait(Tallies::kMacroPairs, Tally::kWanted), 1) &&
        (tiles_.refused() || !tiles_.count(splats_, width, height))) {
      return false;
    }
  }
  tiles_.list(splats_, frame.stopwatch);
  ask();
  listed_ = true;
  return true;
}

void ViewState::blend(const Frame& frame, const gl::DrawScope& scope, bool in_tiles, bool divided) {
  const gl::Target* const farther = divided ? &behind : nullptr;
  if (in_tiles && list(frame)) {
    tiles_.blend(splats_, color, farther);
    rasterizer_ = "tiles";
    frame.stopwatch.lap("blend");
  } else {
    if (unknown_) ask();
    quads_.blend(splats_, color, scope, farther);
    rasterizer_ = "quads";
    frame.stopwatch.lap("quads");
  }
}

void ViewState::ask() {
  tallies_.ask();
  asked_ = true;
  unknown_ = false;
}

bool ViewState::hasRoom(const Frame& frame) {
  if (unknown_) ask();
  if (!asked_) return true;
  asked_ = false;
  // Assumes that splats to come are as visible as the present ones; not all announced ones come.
  std::size_t expected = 0, capacity = 0, most = 0;
  for (const FrameLayer& layer : frame.layers) {
    const auto announced = std::min<std::size_t>(layer.map.expected, kMaxSlots);
    expected += announced;
    capacity += layer.store.capacity();
    most += std::max(layer.store.slots(), announced) + (layer.cuts() ? layer.nodes->slots() : 0);
  }
  const double growth =
      std::clamp(double(expected) / double(std::max<std::size_t>(1, capacity)), 1.0, 4.0);
  bool enough = splats_.checkRoom(most, growth);
  if (listed_) {
    enough =
        tiles_.checkRoom(tallies_.wait(Tallies::kMacroPairs, Tally::kWanted), growth) && enough;
    enough = tiles_.checkLists(tallies_.wait(Tallies::kLists, 0), tallies_.wait(Tallies::kLists, 1),
                               growth) &&
             enough;
  }
  listed_ = false;
  return enough;
}

std::size_t ViewState::bytes() const {
  return splats_.bytes() + tiles_.bytes() + quads_.bytes() + color.bytes() + behind.bytes() +
         translucent.bytes();
}

}  // namespace rosplat
