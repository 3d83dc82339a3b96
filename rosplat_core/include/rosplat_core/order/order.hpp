#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/order/order_slots.hpp"

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

// Makes orders whose slots lie in the memory of former ones. Any thread may make and drop them.
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
  // Lives for as long as there are orders of it.
  std::shared_ptr<SpareSlots> spare_ = std::make_shared<SpareSlots>();
};

}  // namespace rosplat
