#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gl/shaders.hpp"
#include "gpu/frame.hpp"
#include "gpu/projection.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// The splats that a camera sees of maps, projected and in the order in which they are drawn: a
// given order, or one that is sorted here. Kept while camera, maps, settings and order stay.
class OrderedSplats {
 public:
  // sort: may be shared with other objects.
  OrderedSplats(Shaders& shaders, RadixSort& sort, const Tallies& tallies);

  // Whether the splats that were prepared last are those of a frame.
  bool answers(const Frame& frame) const;
  // Submits the projection and the ordering of the splats in view. growth: as Projection has it.
  void prepare(const Frame& frame, double growth);
  // Returns whether prepare() sorted enough bits: then the splats are kept. Waits for the tallies,
  // which must have been asked for.
  bool checkBits();

  const Projection& projection() const { return projection_; }
  const gl::Buffer& drawn() const { return drawn_; }  // indices of ellipses, nearest first
  // How many splats are drawn: on the graphics card; count(): as checkBits() read; at most most();
  // about expected().
  const gl::Slice& tally() const { return order_ ? order_length_ : projection_.seen(); }
  std::size_t count() const { return count_; }
  // Whether any splat may be a solid ball.
  bool hasBalls() const;
  const std::vector<std::size_t>& countsOfLayers() const { return counts_; }
  std::size_t most() const { return order_ ? order_->slots.size() : projection_.slots(); }
  std::size_t expected() const { return likely(count_, most()); }
  std::size_t bytes() const;

 private:
  // What the prepared splats of a layer depend on.
  struct Prepared {
    SplatCamera camera;
    RenderSettings settings;
    Model model;
    std::uint64_t version;  // of the store
    double error;
  };

  void takeOrder(const OrderPtr& order);
  void putInOrder(std::uint32_t capacity);

  const Tallies& tallies_;
  RadixSort& sort_;
  Projection projection_;
  const gl::Program& order_program_;
  OrderPtr order_;          // farthest first; null: splats are sorted here
  gl::Buffer slots_;        // of `order_`
  gl::Slice order_length_;  // of `order_`
  std::vector<Prepared> prepared_;
  bool depths_ = false;  // Frame::depths of these
  bool kept_ = false;    // nothing of `prepared_` was left out
  gl::Buffer page_numbers_, drawn_;
  UsageTracker drawn_used_;  // of `drawn_`
  std::size_t count_ = 0;
  std::vector<std::size_t> counts_;
  int key_bits_ = 32;       // of the depth keys that are sorted
  int fewer_bits_for_ = 0;  // frames in a row that needed fewer bits
};

}  // namespace rosplat
