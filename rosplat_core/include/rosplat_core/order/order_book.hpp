#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/built_in_sorter.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Keeps the orders of each view: those that a sidecar sends, and those that the built-in sorter
// finds. All times are of one monotonic clock [s].
class OrderBook {
 public:
  // How old an order may be that received() returns [s].
  static constexpr double kPatience = 0.25;

  struct Choice {
    OrderPtr order;  // null until there is one
    bool fresh = false;
    double age = 0;  // time since the view left the order's camera, 0 if fresh [s]
  };

  explicit OrderBook(BuiltInSorter& built_in) : built_in_(built_in) {}

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

  // Returns the sidecar's newest order. If the map has changed since, the built-in sorter merges
  // the changed slots into it.
  Choice fromSidecar(const std::string& view_id, double now);
  // Returns the built-in sorter's newest order, and asks for one of the newest camera and map.
  Choice builtIn(const std::string& view_id, double now);
  // Waits for that one.
  Choice sortNow(const std::string& view_id);

  // Returns the sidecar's newest order if it is of the map's revision and at most kPatience old.
  Choice received(const std::string& view_id, double now) const;

  void forget(const std::string& view_id);

 private:
  struct Camera {
    std::uint64_t sequence = 0;
    SplatCamera camera;
    double time = 0;
  };
  struct ViewOrders {
    std::deque<Camera> cameras;  // newest last; equal cameras in a row are kept once
    std::uint64_t sequence = 0;  // newest
    OrderPtr sidecar, built_in, drawn;
    OrderPtr early;  // the sidecar's, of a map or revision that isn't here yet
    std::uint64_t requested_sequence = 0, requested_at = 0;  // requested_at: by changes_
    OrderPtr requested_base;
  };

  bool fresh(const ViewOrders& view, const Order& order) const;
  void takeSorted(const std::string& view_id, ViewOrders& view);
  void request(const std::string& view_id, ViewOrders& view, const OrderPtr& base);
  Choice chosen(const ViewOrders& view, const OrderPtr& order, double now) const;

  BuiltInSorter& built_in_;
  std::map<std::string, ViewOrders> views_;
  MapState map_;
  std::uint64_t changes_ = 0;  // of map_, so far
};

}  // namespace rosplat
