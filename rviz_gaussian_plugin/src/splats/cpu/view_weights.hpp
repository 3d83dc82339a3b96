#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "map/gaussian_map.hpp"
#include "map/host_slots.hpp"

namespace rosplat {

// What slots were to a view's last pictures: of how many pixels each was the colour, the sum of
// alpha x transmittance. Pictures in motion leave out by it what hardly shows. What has come to
// show of that since is found by samples: left out or not, every 16th slot has its turn in each
// picture, and tells of the others of its page. Not for several threads at once.
class ViewWeights {
 public:
  static constexpr float kUnknown = std::numeric_limits<float>::infinity();  // is always drawn

  struct Page {
    HostSlots::PerSlot<float> last;  // [px]
    // Of the picture that is being drawn: so far; less than 0 where it is left out, by what it was.
    HostSlots::PerSlot<float> next;
    std::uint64_t picture = 0;  // the last one that may have shown it
  };

  void beginPicture() { ++picture_; }
  // Whether it leaves out a slot of a page that was the colour of fewer than `least` pixels.
  bool leavesOut(const Page& page, std::size_t slot, float least) const {
    return page.last[slot] < least && !hasItsTurn(slot);
  }
  // For the picture that has begun. Throws std::bad_alloc.
  Page& page(const SlotPage& page);
  // Once that is drawn: its pages, in any thread, then the whole. Of a picture that isn't, the next
  // one still has what was known before.
  // Returns of how many pixels what it left out would have been the colour, by samples.
  double finish(Page& page, float least) const;
  void endPicture() { whole_ = picture_; }

  // What an edit writes is unknown; all is where it moves something.
  void forget(const SlotPages& index, const GaussianEdit& edit);
  std::size_t bytes() const;

 private:
  static constexpr std::size_t kTurns = 16;  // pictures, in which all is drawn once

  bool hasItsTurn(std::size_t slot) const { return (slot + picture_) % kTurns == 0; }

  std::uint64_t picture_ = 0, whole_ = 0;
  std::vector<std::unique_ptr<Page>> pages_;  // by place
};

}  // namespace rosplat
