#pragma once

#include <cstdint>
#include <vector>

#include "gaussian_map.hpp"
#include "gl_objects.hpp"
#include "shaders.hpp"
#include "slot_store.hpp"

namespace rosplat {

// Reads slots back from the GPU.
class SlotReader {
 public:
  explicit SlotReader(const Shaders& shaders) : gather_(shaders.compute({"slot_gather.comp"})) {}

  // Slots as they are drawn, relative to the map's origin. Waits for the graphics card, once.
  std::vector<SplatValues> read(const SlotStore& store,
                                const std::vector<std::uint32_t>& slots) const;

 private:
  gl::Program gather_;
};

}  // namespace rosplat
