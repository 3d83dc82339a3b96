#pragma once

#include <memory>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in a view, for the renderer that holds it as a Map.
template <typename Map>
struct Viewed {
  std::string view_id;  // the display's name of the view
  std::shared_ptr<Map> map;
  SplatCamera camera;  // in the map's frame
  RenderSettings settings;
  OrderPtr order;  // only for a map alone in its picture; null: sorted by depth
  MapState state;  // on a graphics card: as uploaded; else after all waiting edits
};

}  // namespace rosplat
