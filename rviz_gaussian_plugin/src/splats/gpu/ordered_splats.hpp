#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/projection.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/slot_store.hpp"
#include "gpu/tally.hpp"
#include "map/gaussian_map.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// What a camera sees of a map, projected, and in the order in which it is drawn: a given one, or
// one that is found here. It stays while camera, map, settings and order do.
class OrderedSplats {
 public:
  // The sort may be one that others use too.
  OrderedSplats(const Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Makes slots[0..count) the order, farthest first.
  void setOrder(const std::uint32_t* slots, std::size_t count);
  // Has what is visible sorted here, by the sorters' depth and with their ties.
  void sortByDepth();
  // Submits what projects and orders what is visible; false where that is there already. now: the
  // clock of `change` in packed_slot.hpp.
  bool prepare(const SlotStore& store, const SplatCamera& camera, const MapState& map,
               const RenderSettings& settings, double now, gl::Stopwatch& stopwatch);
  // Whether there was room for all of it, which is kept then; else makes it, but never for more
  // than `most`: growth is how much more is to be expected. Waits for the tallies, which must have
  // been asked for.
  bool checkRoom(std::size_t most, double growth);
  // What was prepared isn't what is to be drawn any more.
  void forget() { kept_ = false; }

  const Projection& projection() const { return projection_; }
  const gl::Buffer& drawn() const { return drawn_; }  // indices of ellipses, nearest first
  // How many: what the graphics card knows, what was counted last, and at most.
  const Tally& tally() const { return order_.given ? order_.tally : projection_.visible(); }
  std::size_t count() const { return count_; }
  std::size_t most() const { return order_.given ? order_.count : projection_.room(); }
  std::size_t bytes() const;

 private:
  struct Order {
    explicit Order(const Tallies& tallies) : tally(tallies.of(Tallies::kOrder)) {}

    bool given = false;
    gl::Buffer slots;  // farthest first
    std::size_t count = 0;
    Tally tally;  // the same
  };
  // What the projected, ordered splats answer.
  struct Prepared {
    SplatCamera camera;
    RenderSettings settings;
    std::array<double, 3> origin{};
    bool antialiased = false;
  };

  bool answers(const SplatCamera& camera, const MapState& map,
               const RenderSettings& settings) const;
  void putInOrder(std::uint32_t capacity);

  const Tallies& tallies_;
  RadixSort& sort_;
  Projection projection_;
  gl::Program order_program_;
  Order order_;
  Prepared prepared_;
  bool kept_ = false;  // prepared_ is whole
  gl::Buffer page_numbers_, drawn_;
  std::size_t count_ = 0;
  int key_bits_ = 32;       // by which depths are sorted
  int fewer_bits_for_ = 0;  // frames for which fewer would have done
};

}  // namespace rosplat
