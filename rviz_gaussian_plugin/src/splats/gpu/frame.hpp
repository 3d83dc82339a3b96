#pragma once

#include "gl/gl_objects.hpp"
#include "gpu/slot_store.hpp"
#include "map/gaussian_map.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"
#include "order/order.hpp"

namespace rosplat {

// What is drawn, and how.
struct Frame {
  const SlotStore& store;
  const SplatCamera& camera;
  const MapState& map;
  const RenderSettings& settings;
  OrderPtr order;  // null: by the sorters' depth and with their ties
  bool top_first;  // the target's first row is the picture's top
  double now;      // the clock of `change` in packed_slot.hpp
  gl::Stopwatch& stopwatch;
};

}  // namespace rosplat
