#pragma once

#include <array>
#include <cstddef>

#include "gl_objects.hpp"
#include "radix_sort.hpp"
#include "render_settings.hpp"
#include "shaders.hpp"
#include "slot_store.hpp"
#include "splat_camera.hpp"

namespace rosplat {

// What the camera sees of a map: the slots that may be visible are found, counted and projected to
// ellipses that lie one after the other, in the order of their slots.
class Projection {
 public:
  explicit Projection(const Shaders& shaders);

  // now: the clock of `change` in packed_slot.hpp. Throws gl::Error where the driver has no memory.
  void run(const SlotStore& store, const SplatCamera& camera, const MapState& map,
           const RenderSettings& settings, double now);

  std::size_t count() const { return count_; }          // ellipses
  void bindEllipses(const gl::Program& program) const;  // storage bindings 0 to 3
  void bindVisible() const;                             // storage bindings 5 and 6
  const gl::Buffer& depthRange() const { return depth_range_; }
  // Grow with the ellipses' depths; whoever sorts may take the buffer.
  gl::Buffer& keys() { return keys_; }
  std::size_t bytes() const;

 private:
  void cull(const SlotStore& store, const SplatCamera& camera, const MapState& map,
            const RenderSettings& settings);
  void project(const SlotStore& store, const SplatCamera& camera, const MapState& map,
               const RenderSettings& settings, double now);

  gl::Program cull_, project_;
  PrefixSum prefix_sum_;
  std::size_t part_size_;
  gl::Buffer visible_, before_, total_;
  std::array<gl::Buffer, Shaders::kEllipseParts> ellipses_;
  gl::Buffer keys_;
  gl::Buffer depth_range_;  // nearest and farthest depth drawn, as float bits
  std::size_t count_ = 0;
};

}  // namespace rosplat
