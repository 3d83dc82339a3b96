#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/built_in_sorter.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Decides, view by view, which order to draw: a sidecar's that answers the newest camera and map;
// else the sidecar's last one for a moment, changed slots merged in; else the built-in sort. All
// times are of one monotonic clock. [s]
class OrderBook {
 public:
  // How long a silent sidecar is waited for. Above the 82 ms that sorting 5M splats takes on one
  // core.
  static constexpr double kPatience = 0.25;

  struct Choice {
    OrderPtr order;  // null until there is one
    bool fresh = false;
    double age = 0;  // since the order's camera was left, 0 where fresh [s]
  };

  explicit OrderBook(BuiltInSorter& built_in) : built_in_(built_in) {}

  // The view's camera; sequence grows by one with each.
  void setCamera(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera,
                 double now);

  // The map has another revision now.
  void mapChanged(const MapState& map, double now);

  // A sidecar's order; false where it answers no view or map that is here.
  bool offer(const OrderPtr& order, double now);

  // A sidecar's order is there that answers the newest camera and the newest map.
  bool answered(const std::string& view_id) const;

  // The order to draw now; asks the built-in sorter for what is missing. A source other than kAuto
  // rules the others out.
  Choice choose(const std::string& view_id, double now, OrderSource source = OrderSource::kAuto);

  // The same, but sorted here and now, whatever the sidecar said.
  Choice sortNow(const std::string& view_id);

  // The sidecar's newest order of the map as it is; null where it has lost patience with it.
  Choice received(const std::string& view_id, double now) const;

  void forget(const std::string& view_id);

 private:
  struct Camera {
    std::uint64_t sequence = 0;
    SplatCamera camera;
    double time = 0;
  };
  struct ViewOrders {
    std::deque<Camera> cameras;  // newest last; equal ones are one
    std::uint64_t sequence = 0;  // newest
    OrderPtr sidecar, built_in, drawn;
    OrderPtr early;            // the sidecar's, of a revision that has not arrived here yet
    double waiting_since = 0;  // for the sidecar
    std::uint64_t requested_sequence = 0, requested_at = 0;
    OrderPtr requested_base;
  };

  bool fresh(const ViewOrders& view, const Order& order) const;
  void request(const std::string& view_id, ViewOrders& view, const OrderPtr& base);
  Choice chosen(const ViewOrders& view, const OrderPtr& order, double now) const;

  BuiltInSorter& built_in_;
  std::map<std::string, ViewOrders> views_;
  MapState map_;
  std::uint64_t changes_ = 0;  // of it
};

}  // namespace rosplat
