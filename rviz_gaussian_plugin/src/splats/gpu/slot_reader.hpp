#pragma once

#include <cstdint>
#include <vector>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/slot_store.hpp"
#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// Reads slots back from the GPU.
class SlotReader {
 public:
  explicit SlotReader(Shaders& shaders) : gather_(shaders.compute({"slot_gather.comp"})) {}

  // Returns slots as they are drawn. Waits for the graphics card, once.
  std::vector<SplatValues> read(const SlotStore& store,
                                const std::vector<std::uint32_t>& slots) const;

 private:
  const gl::Program& gather_;
};

}  // namespace rosplat
