#include "gpu/view_state.hpp"

#include <algorithm>
#include <utility>

#include "gpu/view_block.hpp"

namespace rosplat {

namespace {

// By how much the maps will grow. Assumes that splats to come are as visible as the present ones;
// not all announced ones come.
double growthOf(const Frame& frame) {
  std::size_t expected = 0, capacity = 0;
  for (const FrameLayer& layer : frame.layers) {
    expected += std::min<std::size_t>(layer.map.expected, kMaxSlots);
    capacity += layer.store.capacity();
  }
  return std::clamp(double(expected) / double(std::max<std::size_t>(1, capacity)), 1.0, 4.0);
}

}  // namespace

ViewState::ViewState(Shaders& shaders, RadixSort& sort)
    : splats_(shaders, sort, tallies_),
      tiles_(shaders, sort, tallies_),
      block_(sizeof(ViewBlock), GL_DYNAMIC_DRAW) {}

void ViewState::prepare(const Frame& frame) {
  // The frame before may still read what this one writes.
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);
  const ViewBlock block(frame);
  block_.write(0, &block, sizeof(block));
  use();
  width_ = frame.camera().width;
  height_ = frame.camera().height;
  top_first_ = frame.top_first;
  if (splats_.answers(frame)) return;
  growth_ = growthOf(frame);
  splats_.prepare(frame, growth_);
  tiles_.forget();
}

void ViewState::list(gl::Stopwatch& stopwatch) {
  if (!tiles_.listed(width_, height_) && tiles_.regions() == 1) list(0, stopwatch);
}

void ViewState::list(std::size_t region, gl::Stopwatch& stopwatch) {
  tiles_.list(splats_, width_, height_, region, stopwatch);
  tallies_.reported();
  listed_ = reported_ = true;
}

void ViewState::inRegions(gl::Stopwatch& stopwatch, const std::function<void()>& draw) {
  if (tiles_.listed(width_, height_)) return draw();
  std::size_t region = 0;
  do {
    list(region, stopwatch);
    const std::size_t regions = tiles_.regions();
    // Regions share the memory of their lists, so this one must be whole before the next begins.
    if (regions > 1 && !checkRoomForLists(1)) {
      if (tiles_.regions() != regions) region = 0;
      continue;
    }
    draw();
    ++region;
  } while (region < tiles_.regions());
}

void ViewState::blend(gl::Stopwatch& stopwatch, bool divided) {
  inRegions(stopwatch, [&] {
    tiles_.blend(splats_, color, divided ? &behind : nullptr);
    stopwatch.lap("blend");
  });
}

void ViewState::blendDepth(PictureDepth depth, const gl::Target& target) {
  gl::Stopwatch unused(false);
  do {
    inRegions(unused, [&] { tiles_.blendDepth(splats_, depth, target); });
  } while (!checkRoomForLists(1));
}

bool ViewState::checkRoom() {
  if (!std::exchange(reported_, false)) return true;
  const bool enough = splats_.checkBits();
  return checkRoomForLists(growth_) && enough;
}

bool ViewState::checkRoomForLists(double growth) {
  if (!std::exchange(listed_, false)) return true;
  return tiles_.checkRoom({tallies_.wait(Tallies::kMacroPairs, Tallies::kWanted),
                           tallies_.wait(Tallies::kLists, 0), tallies_.wait(Tallies::kLists, 1)},
                          growth);
}

std::size_t ViewState::bytes() const {
  return splats_.bytes() + tiles_.bytes() + color.bytes() + behind.bytes() + translucent.bytes();
}

}  // namespace rosplat
