#pragma once

#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <utility>
#include <vector>

namespace rosplat {

// The splats of a map in a part of a picture, once they are found: slots by pixel, top row first,
// kNoSlot where there is none. Dropping all Picks of one search cancels the search.
class Pick {
 public:
  using Slots = std::vector<std::uint32_t>;

  Pick(std::future<Slots> slots, std::shared_ptr<void> wanted)
      : slots_(std::move(slots)), wanted_(std::move(wanted)) {}
  // For slots that are found already.
  explicit Pick(Slots slots) {
    std::promise<Slots> promise;
    promise.set_value(std::move(slots));
    slots_ = promise.get_future();
  }

  bool found() const {
    return slots_.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  }
  // Waits for the slots. To be called once. Throws the search's exception if that failed.
  Slots slots() { return slots_.get(); }

 private:
  std::future<Slots> slots_;
  std::shared_ptr<void> wanted_;
};

}  // namespace rosplat
