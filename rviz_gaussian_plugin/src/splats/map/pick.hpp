#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <future>
#include <memory>
#include <utility>
#include <vector>

namespace rosplat {

// Which splats a part of a picture shows, once somebody has found them: slots by pixel, top row
// first, kNoSlot where there is none. Who lets go of it before gives it up.
class Pick {
 public:
  using Slots = std::vector<std::uint32_t>;
  using GivenUp = std::shared_ptr<std::atomic<bool>>;

  Pick(std::future<Slots> slots, GivenUp given_up)
      : slots_(std::move(slots)), given_up_(std::move(given_up)) {}
  // Found already.
  explicit Pick(Slots slots) {
    std::promise<Slots> promise;
    promise.set_value(std::move(slots));
    slots_ = promise.get_future();
  }
  ~Pick() {
    if (given_up_) *given_up_ = true;
  }
  Pick(Pick&&) = default;
  Pick& operator=(Pick&&) = delete;

  bool found() const {
    return slots_.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  }
  // Once; waits for them. Throws what kept them from being found.
  Slots slots() { return slots_.get(); }

 private:
  std::future<Slots> slots_;
  GivenUp given_up_;
};

}  // namespace rosplat
