#include "rosplat_core/map/arrivals.hpp"

#include <algorithm>
#include <new>
#include <utility>

#include "rosplat_core/threads/freed_memory.hpp"

namespace rosplat {

namespace {

constexpr std::chrono::milliseconds kRetry{500};
// Messages and edits of so many bytes leave as much free memory between the pages of the map.
constexpr std::size_t kTakenPerReturn = 64'000'000;
// Returning that memory takes the time of a frame: not while a map streams in.
constexpr std::chrono::seconds kQuiet{1};

}  // namespace

void Arrivals::push(const Edit& edit, const MapState& state) {
  auto arrival = EditQueue::node(edit, state);
  MapState after = state;  // the last step that needs memory
  const std::lock_guard lock(mutex_);
  state_ = std::move(after);
  waiting_.push(std::move(arrival));
}

void Arrivals::clear() {
  const std::lock_guard lock(mutex_);
  waiting_.clear();
  error_ = nullptr;
}

bool Arrivals::applyNext(std::uint64_t taker, const Apply& apply, const UploadBudget& budget) {
  if (going_over_) return false;
  const std::lock_guard taking(taking_);
  if (taker != taker_) return false;
  EditQueue::Node oldest;
  std::exception_ptr error;
  try {
    {
      std::unique_lock lock(mutex_);
      if (waiting_.empty()) {
        lock.unlock();
        returnFreed();
        return false;
      }
      if (error_ && Clock::now() < retry_) return false;
      const std::size_t bytes = uploadBytes(*waiting_.front().edit);
      if (budget.used > 0 && budget.used + std::min(bytes, budget.all) > budget.all) return false;
      oldest = waiting_.pop(budget.all);
    }
    apply(oldest.front());
    taken_ += uploadBytes(*oldest.front().edit);
    taken_at_ = Clock::now();
  } catch (...) {
    error = std::current_exception();
  }
  const std::lock_guard lock(mutex_);
  if (error) {
    if (!oldest.empty()) waiting_.putBack(std::move(oldest));
    retry_ = Clock::now() + kRetry;
  }
  error_ = error;
  return !error;
}

void Arrivals::returnFreed() {
  if (taken_ < kTakenPerReturn || Clock::now() < taken_at_ + kQuiet) return;
  taken_ = 0;
  returnFreedMemory();
}

void Arrivals::handOver(const Taker& to, const std::function<void()>& copy) {
  going_over_ = true;
  const std::shared_ptr<void> over(nullptr, [this](void*) { going_over_ = false; });
  const std::lock_guard taking(taking_);
  copy();
  taker_ = to.number_;
  const std::lock_guard lock(mutex_);
  retry_ = Clock::now();
}

MapState Arrivals::state() const {
  const std::lock_guard lock(mutex_);
  return state_;
}

Backlog Arrivals::backlog() const {
  const std::lock_guard lock(mutex_);
  return {waiting_.size(), waiting_.bytes()};
}

std::string Arrivals::error() const {
  std::exception_ptr error;
  {
    const std::lock_guard lock(mutex_);
    error = error_;
  }
  if (!error) return "";
  const std::string missing = "a part of the map isn't drawn: ";
  try {
    std::rethrow_exception(error);
  } catch (const std::bad_alloc&) {
    return missing + "memory is lacking";
  } catch (const std::exception& why) {
    return missing + why.what();
  }
}

}  // namespace rosplat
