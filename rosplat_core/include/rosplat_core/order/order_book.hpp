#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Keeps the orders that a sidecar sends for each view. All times are of one monotonic clock [s].
class OrderBook {
 public:
  // How old an order may be that newest() returns [s].
  static constexpr double kPatience = 0.25;

  struct Choice {
    OrderPtr order;  // null until there is one
    bool fresh = false;
    double age = 0;  // time since the view left the order's camera, 0 if fresh [s]
  };

  // Sets the view's camera; sequence grows by one with each.
  void setCamera(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera,
                 double now);

  // Tells that the map has another revision.
  void mapChanged(const MapState& map);

  // Takes a sidecar's order; one of a map or revision that isn't here yet waits for that. Returns
  // false if the order is refused: of an unknown view or camera, worse than the last, or too large.
  bool offer(const OrderPtr& order);

  // Whether a sidecar's order answers the newest camera and the newest map.
  bool answered(const std::string& view_id) const;

  // Returns the newest order if it is of the map's revision and at most kPatience old.
  Choice newest(const std::string& view_id, double now) const;

  void forget(const std::string& view_id) { views_.erase(view_id); }

 private:
  struct Camera {
    std::uint64_t sequence = 0;
    SplatCamera camera;
    double time = 0;
  };
  struct ViewOrders {
    std::deque<Camera> cameras;  // newest last; equal cameras in a row are kept once
    std::uint64_t sequence = 0;  // newest
    OrderPtr newest;             // of the map as it is, or as it was
    OrderPtr early;              // of a map or revision that isn't here yet
  };

  bool fresh(const ViewOrders& view, const Order& order) const;

  std::map<std::string, ViewOrders> views_;
  MapState map_;
};

}  // namespace rosplat
