#pragma once

#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <utility>
#include <vector>

namespace rosplat {

// Which splats of a map a part of a picture shows, once somebody has found them: slots by pixel,
// top row first, kNoSlot where there is none. Who lets go of all that are found at once gives them
// up.
class Pick {
 public:
  using Slots = std::vector<std::uint32_t>;

  Pick(std::future<Slots> slots, std::shared_ptr<void> wanted)
      : slots_(std::move(slots)), wanted_(std::move(wanted)) {}
  // Found already.
  explicit Pick(Slots slots) {
    std::promise<Slots> promise;
    promise.set_value(std::move(slots));
    slots_ = promise.get_future();
  }

  bool found() const {
    return slots_.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  }
  // Once; waits for them. Throws what kept them from being found.
  Slots slots() { return slots_.get(); }

 private:
  std::future<Slots> slots_;
  std::shared_ptr<void> wanted_;
};

}  // namespace rosplat
