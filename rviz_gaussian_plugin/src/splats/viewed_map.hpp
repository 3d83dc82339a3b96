#pragma once

#include <memory>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in a view, as what draws it holds it.
template <typename Map>
struct Viewed {
  std::string view_id;  // its display's name for it
  std::shared_ptr<Map> map;
  SplatCamera camera;  // in the map's frame
  RenderSettings settings;
  OrderPtr order;  // null: by depth; of a map that is alone
  MapState state;  // on a graphics card as it is there, else with all that waits
};

}  // namespace rosplat
