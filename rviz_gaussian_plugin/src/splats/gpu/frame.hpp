#pragma once

#include <array>

#include "gl/gl_objects.hpp"
#include "gpu/node_store.hpp"
#include "gpu/slot_store.hpp"
#include "map/cut.hpp"
#include "map/gaussian_map.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"
#include "order/order.hpp"

namespace rosplat {

// What is drawn, and how.
struct Frame {
  const SlotStore& store;
  const NodeStore* nodes;  // of levels of detail; null where there are none
  const SplatCamera& camera;
  const MapState& map;
  const RenderSettings& settings;
  double error;    // to which nodes stand for splats, 0: all is drawn in full [px]
  OrderPtr order;  // null: by the sorters' depth and with their ties
  bool top_first;  // the target's first row is the picture's top
  double now;      // the clock of `change` in packed_slot.hpp
  gl::Stopwatch& stopwatch;

  bool cuts() const { return nodes && error > 0; }
  // seen_from: the camera in the frame of a group, of which this is the origin.
  Cut cut(const SplatCamera& seen_from, const std::array<double, 3>& origin) const {
    return {seen_from, origin, error, drawsBalls(settings.mode)};
  }
};

}  // namespace rosplat
