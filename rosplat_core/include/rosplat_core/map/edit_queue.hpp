#pragma once

#include <cstddef>
#include <list>
#include <memory>

#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// How much an edit uploads. [bytes]
std::size_t uploadBytes(const GaussianEdit& edit);

// Edits that wait to be taken, oldest first, each with the map's state after it. Slots that later
// edits overwrite are left out as soon as that is worthwhile: the queue takes little more memory
// than the slots that it writes, however many edits came. Two moves of a group become one, unless
// the group is written to in between. For one thread at a time.
class EditQueue {
 public:
  struct Waiting {
    std::shared_ptr<const GaussianEdit> edit;
    MapState state;
    double now = 0;         // time of push(), by the caller's clock
    std::size_t taken = 0;  // slots taken in earlier parts
    bool more = false;      // the rest of the edit follows
  };
  using Node = std::list<Waiting>;  // of one element, so that push() needs no memory

  // worthwhile: how much has to come before overwritten slots are left out. [bytes]
  explicit EditQueue(std::size_t worthwhile = 16u << 20) : worthwhile_(worthwhile) {}

  static Node node(std::shared_ptr<const GaussianEdit> edit, const MapState& state,
                   double now = 0) {
    return Node(1, {std::move(edit), state, now, 0, false});
  }
  // An edit that clears the map drops all that waits.
  void push(Node node) noexcept;
  // The oldest edit; there must be one.
  const Waiting& front() const { return waiting_.front(); }
  Waiting pop();
  // Pops the oldest edit, or the next part of a larger one: parts upload most_bytes at most, but a
  // slot at least. While further parts follow, MapState::pulled is set.
  Node pop(std::size_t most_bytes);
  // Puts what was taken last back to the front, unless a clear has come since.
  void putBack(Node node) noexcept;
  void clear();

  bool empty() const { return waiting_.empty(); }
  std::size_t size() const { return waiting_.size(); }
  std::size_t bytes() const { return bytes_; }

 private:
  Node popNode() noexcept;
  void coalesce();

  std::size_t worthwhile_;
  std::list<Waiting> waiting_;
  std::size_t bytes_ = 0;
  std::size_t settled_ = 0;  // bytes_ after overwritten slots were left out last
};

}  // namespace rosplat
