#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/order/order_slots.hpp"

namespace rosplat {

// The visible slots of a view, farthest first, and the camera and map that they answer.
struct Order {
  std::string view_id;
  std::uint64_t sequence = 0;  // of the view's camera
  std::string map_id;
  std::uint64_t revision = 0;  // of the map
  std::string source;          // the sorter's name
  double sort_time = 0;        // [s]
  std::vector<std::uint32_t> slots;
  std::size_t bound = 0;  // all slots are less
};
using OrderPtr = std::shared_ptr<const Order>;

// Makes orders that reuse the memory of dropped orders. Any thread may make and drop orders.
class OrderPool {
 public:
  // Returns an order that answers nothing yet; its slots are those that a former order left.
  std::shared_ptr<Order> make() {
    auto order = std::make_unique<Order>();
    order->slots = spare_->reuse();
    return {order.release(), [spare = spare_](Order* dropped) {
              spare->giveBack(std::move(dropped->slots));
              delete dropped;
            }};
  }

 private:
  // Shared with the orders, which may outlive the pool.
  std::shared_ptr<SpareSlots> spare_ = std::make_shared<SpareSlots>();
};

}  // namespace rosplat
