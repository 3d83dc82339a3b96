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

// How much may be uploaded at once, and how much of that is used. [bytes]
struct UploadBudget {
  std::size_t all = std::numeric_limits<std::size_t>::max(), used = 0;
};

// The edits of a map on their way to its Drawer. An edit stays here until the drawn map holds all
// of it. An edit is applied under the lock that handOver() takes; one that fails is tried again
// before later ones. So no edit is lost when the Drawer changes. For any thread.
class Arrivals : public std::enable_shared_from_this<Arrivals> {
 public:
  using Edit = std::shared_ptr<const GaussianEdit>;
  // Applies an edit. May throw, even halfway; it is then called with that edit again.
  using Apply = std::function<void(const EditQueue::Waiting& arrival)>;

  // A drawer's permission to take edits: handOver() gives it to one drawer, and ends that of the
  // drawer before.
  class Taker {
   public:
    // Applies the oldest edit, or a part of it as large as the whole budget. Returns false if none
    // waits, it failed, another taker has the right, or it exceeds what is left of the budget.
    bool applyNext(const Apply& apply, const UploadBudget& budget = {}) const {
      return from_->applyNext(number_, apply, budget);
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

  // Returns a taker that has no right yet.
  Taker makeTaker() { return {shared_from_this(), ++takers_}; }
  // Runs copy while nobody takes edits, then gives the right to another taker. If copy throws, so
  // does handOver(), and the previous taker keeps the right.
  void handOver(const Taker& to, const std::function<void()>& copy);

  // The map after all waiting edits.
  MapState state() const;
  Backlog backlog() const;
  // Why the oldest edit failed, empty if it didn't. The edit is tried again twice a second.
  std::string error() const;

 private:
  using Clock = std::chrono::steady_clock;

  bool applyNext(std::uint64_t taker, const Apply& apply, const UploadBudget& budget);
  void returnFreed();

  std::mutex taking_;  // held while an edit is applied or the map is handed over
  std::uint64_t taker_ = 0;
  std::size_t taken_ = 0;  // since freed memory was returned [bytes]
  Clock::time_point taken_at_;
  std::atomic<std::uint64_t> takers_{0};
  std::atomic<bool> going_over_{false};  // makes takers let handOver() in

  mutable std::mutex mutex_;  // guards the members below
  EditQueue waiting_;
  MapState state_;
  std::exception_ptr error_;
  Clock::time_point retry_;  // when to try again after an error
};

}  // namespace rosplat
