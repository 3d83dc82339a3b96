#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace rosplat {

// The visible slots of a view, farthest first, and what they answer.
struct Order {
  std::string view_id;
  std::uint64_t sequence = 0;  // of the view's camera
  std::string map_id;
  std::uint64_t revision = 0;  // of the map
  std::string source;          // who sorted
  double sort_time = 0;        // [s]
  std::vector<std::uint32_t> slots;
  std::size_t bound = 0;  // that all slots are below
};
using OrderPtr = std::shared_ptr<const Order>;

// Makes orders whose slots lie in the memory of former ones: pages that are new to a process cost
// several times what filling them does. Any thread may make and drop them.
class OrderPool {
 public:
  // An order that answers nothing yet; its slots are what was left there.
  std::shared_ptr<Order> make() {
    auto order = std::make_unique<Order>();
    order->slots = spare_->take();
    return {order.release(), [spare = spare_](Order* dropped) {
              spare->keep(std::move(dropped->slots));
              delete dropped;
            }};
  }

 private:
  // Outlives the pool for as long as there are orders of it.
  class Spare {
   public:
    std::vector<std::uint32_t> take() {
      const std::lock_guard lock(mutex_);
      if (slots_.empty()) return {};
      std::vector<std::uint32_t> taken = std::move(slots_.back());
      slots_.pop_back();
      return taken;
    }
    void keep(std::vector<std::uint32_t>&& slots) {
      const std::lock_guard lock(mutex_);
      if (slots_.size() < kMost) slots_.push_back(std::move(slots));
    }

   private:
    // One is drawn while one waits and one is read.
    static constexpr std::size_t kMost = 3;

    std::mutex mutex_;
    std::vector<std::vector<std::uint32_t>> slots_;
  };

  std::shared_ptr<Spare> spare_ = std::make_shared<Spare>();
};

}  // namespace rosplat
