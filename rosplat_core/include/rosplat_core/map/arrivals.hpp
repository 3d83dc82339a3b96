#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <string>

#include "rosplat_core/map/edit_queue.hpp"
#include "rosplat_core/map/gaussian_map.hpp"

namespace rosplat {

// What has arrived and isn't drawn yet.
struct Backlog {
  std::size_t edits = 0;
  std::size_t bytes = 0;
};

// What of edits is to be uploaded at once, and how much of that already is. [bytes]
struct UploadBudget {
  std::size_t all = std::numeric_limits<std::size_t>::max(), used = 0;
};

// The edits of a map on their way to who draws it. An edit is here until it is all in that map: who
// takes it applies it under the lock under which the map goes over to another, and one that fails
// comes first again. So none is lost, whoever draws. All of it from any thread.
class Arrivals : public std::enable_shared_from_this<Arrivals> {
 public:
  using Edit = std::shared_ptr<const GaussianEdit>;
  // Has an edit in the map. May throw, in the middle of it; is then called with it again.
  using Apply = std::function<void(const EditQueue::Waiting& arrival)>;

  // Who may take edits, from handOver() to this one until handOver() to another.
  class Taker {
   public:
    // Has the oldest edit applied, or as much of it as a whole budget is; false where none is to be
    // taken now, or it is more than is left of that.
    bool take(const Apply& apply, const UploadBudget& budget = {}) const {
      return from_->take(number_, apply, budget);
    }
    const Arrivals& from() const { return *from_; }

   private:
    friend class Arrivals;
    Taker(std::shared_ptr<Arrivals> from, std::uint64_t number)
        : from_(std::move(from)), number_(number) {}

    std::shared_ptr<Arrivals> from_;
    std::uint64_t number_;
  };

  void push(const Edit& edit, const MapState& state);
  void clear();

  // One who takes nothing yet.
  Taker makeTaker() { return {shared_from_this(), ++takers_}; }
  // Lets another take edits once the map is copied, while nobody does. If the copy throws, this
  // does, and who took edits before goes on.
  void handOver(const Taker& to, const std::function<void()>& copy);

  // The map after all that waits.
  MapState state() const;
  Backlog backlog() const;
  // Why the oldest isn't in the map yet, although it was tried; empty where nothing is wrong. It is
  // tried again twice a second.
  std::string error() const;

 private:
  using Clock = std::chrono::steady_clock;

  bool take(std::uint64_t taker, const Apply& apply, const UploadBudget& budget);

  std::mutex taking_;  // while an edit is applied, or the map goes over
  std::uint64_t taker_ = 0;
  std::atomic<std::uint64_t> takers_{0};
  std::atomic<bool> going_over_{false};  // let in whoever hands the map over

  mutable std::mutex mutex_;  // what follows
  EditQueue waiting_;
  MapState state_;
  std::exception_ptr error_;
  Clock::time_point retry_;  // from when on, if there is an error
};

}  // namespace rosplat
