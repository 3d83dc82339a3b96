#pragma once

#include <cstddef>
#include <list>
#include <memory>

#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// What an edit uploads.
std::size_t uploadBytes(const GaussianEdit& edit);

// Edits that wait to be taken over, oldest first, each with the map's state after it. What later
// ones overwrite is left out as soon as that is worth it: what waits takes little more memory than
// the slots that it writes, however many edits there were. Groups that are moved again are moved
// once, unless they are written to in between. For one thread at a time.
class EditQueue {
 public:
  struct Waiting {
    std::shared_ptr<const GaussianEdit> edit;
    MapState state;
    double now = 0;         // when, by the clock of who puts it in
    std::size_t taken = 0;  // slots, in parts
    bool more = false;      // the rest of the edit follows
  };
  using Node = std::list<Waiting>;  // of one, to be put in without memory

  // worthwhile: how much may wait anyway. [bytes]
  explicit EditQueue(std::size_t worthwhile = 16u << 20) : worthwhile_(worthwhile) {}

  static Node node(std::shared_ptr<const GaussianEdit> edit, const MapState& state,
                   double now = 0) {
    return Node(1, {std::move(edit), state, now, 0, false});
  }
  // A clear drops all that waits.
  void push(Node node) noexcept;
  // The oldest; there must be one.
  const Waiting& front() const { return waiting_.front(); }
  Waiting pop();
  // The same, of an edit that is larger in parts that upload no more than so many bytes each, but a
  // slot at least. While there are further ones, the state says that more is on its way.
  Node take(std::size_t most_bytes);
  // What was taken last is the oldest again, unless a clear has come since.
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
  std::size_t settled_ = 0;  // bytes, when what was overwritten was left out last
};

}  // namespace rosplat
