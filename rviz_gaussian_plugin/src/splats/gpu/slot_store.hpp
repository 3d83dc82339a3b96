#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "gl/gl_objects.hpp"
#include "map/gaussian_map.hpp"

namespace rosplat {

// The slots of a map in the GPU's memory, in pages: a map grows without a copy of what is there,
// and a range of slots that nobody uses costs nothing.
class SlotStore {
 public:
  static constexpr std::uint32_t kPageSlots = 1u << 16;

  struct Page {
    gl::Buffer slots;                                // kSlotWords a slot
    std::array<gl::Buffer, kMaxShDegree + 1> bands;  // kBandWords a slot, from band 1 on
  };

  // Uploads what an edit changes. now: the clock of `change` in packed_slot.hpp. Throws gl::Error
  // when the driver has no memory left.
  void apply(const GaussianEdit& edit, double now);

  const std::unordered_map<std::uint32_t, Page>& pages() const { return pages_; }  // by first slot
  std::uint32_t capacity() const { return capacity_; }
  int shDegree() const { return sh_degree_; }
  std::size_t bytes() const;

 private:
  Page& page(std::uint32_t first_slot, bool overwritten);
  void addBands(int degree);

  std::unordered_map<std::uint32_t, Page> pages_;
  std::uint32_t capacity_ = 0;
  int sh_degree_ = 0;
  std::vector<std::uint32_t> staged_;
};

}  // namespace rosplat
