#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/frame.hpp"
#include "gpu/projection.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// What a camera sees of maps, projected, and in the order in which it is drawn: a given one, or
// one that is found here. It stays while camera, maps, settings and order do.
class OrderedSplats {
 public:
  // The sort may be one that others use too.
  OrderedSplats(Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Whether what was prepared is what is to be drawn.
  bool answers(const Frame& frame) const;
  // Submits what projects and orders what is visible.
  void prepare(const Frame& frame);
  // Whether there was room for all of it, which is kept then; else makes it, but never for more
  // than `most`: growth is how much more is to be expected. Waits for the tallies, which must have
  // been asked for.
  bool checkRoom(std::size_t most, double growth);

  const Projection& projection() const { return projection_; }
  const gl::Buffer& drawn() const { return drawn_; }  // indices of ellipses, nearest first
  // How many: what the graphics card knows, what was counted last, and at most.
  const Tally& tally() const { return order_ ? order_length_ : projection_.visible(); }
  std::size_t count() const { return count_; }
  // Whether any may be a solid ball.
  bool hasBalls() const;
  const std::vector<std::size_t>& countsOfLayers() const { return counts_; }
  std::size_t most() const { return order_ ? order_->slots.size() : projection_.room(); }
  std::size_t bytes() const;

 private:
  // What the projected, ordered splats answer, of a layer.
  struct Prepared {
    SplatCamera camera;
    RenderSettings settings;
    bool antialiased;
    std::uint64_t version;  // of the store
    double error;
  };

  void takeOrder(const OrderPtr& order);
  void putInOrder(std::uint32_t capacity);

  const Tallies& tallies_;
  RadixSort& sort_;
  Projection projection_;
  const gl::Program& order_program_;
  OrderPtr order_;      // farthest first; null: what is visible is sorted here
  gl::Buffer slots_;    // of the order
  Tally order_length_;  // the same
  std::vector<Prepared> prepared_;
  bool kept_ = false;  // prepared_ is whole
  gl::Buffer page_numbers_, drawn_;
  std::size_t count_ = 0;
  std::vector<std::size_t> counts_;
  int key_bits_ = 32;       // by which depths are sorted
  int fewer_bits_for_ = 0;  // frames for which fewer would have done
};

}  // namespace rosplat
