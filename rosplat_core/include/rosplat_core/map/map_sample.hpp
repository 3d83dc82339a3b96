#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace rosplat {

// What decides how well a splat can be drawn.
struct SampledSplat {
  std::array<float, 3> position{};  // relative to its group's origin [m]
  float size = -1;                  // largest standard deviation [m], -1 of an empty slot
  float opacity = 0;
  std::uint32_t group = 0;  // by index
};

// Every 2^k-th slot of a map, with k such that a few thousand stay: for statistics of the whole.
class MapSample {
 public:
  static constexpr std::size_t kMost = 4096;

  void set(std::uint32_t slot, const SampledSplat& splat) noexcept;
  void drop(std::uint32_t slot) noexcept { set(slot, {}); }

  // Slots that aren't empty.
  std::vector<SampledSplat> splats() const;

 private:
  int k_ = 0;
  std::vector<SampledSplat> splats_{kMost};  // by slot / 2^k
};

}  // namespace rosplat
