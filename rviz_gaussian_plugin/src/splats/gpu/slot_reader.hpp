#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "gl/program.hpp"
#include "gl/readback.hpp"
#include "gl/shaders.hpp"
#include "gpu/slot_store.hpp"
#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// Reads single slots back from the GPU.
class SlotReader {
 public:
  explicit SlotReader(Shaders& shaders) : gather_(shaders.compute({"slot_gather.comp"})) {}

  // Returns slots as they are drawn. Waits for the graphics card, once.
  std::vector<SplatValues> read(const SlotStore& store,
                                const std::vector<std::uint32_t>& slots) const;

 private:
  const gl::Program& gather_;
};

// Reads whole pages of slots back from the GPU. Keeps the memory for it from one read to the next.
class PageReader {
 public:
  // Returns pages()[first], which the store holds, and the pages after it that lie next to each
  // other in map and arena, at most `most` in all. Waits for the graphics card. run: memory to use
  // again. Throws gl::Error when the driver has no memory left.
  PackedRun read(const SlotStore& store, std::size_t first, std::size_t most, PackedRun run = {});

 private:
  std::optional<gl::Readback> copy_;
};

}  // namespace rosplat
