#pragma once

#include <string>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order_book.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in a picture. Map: a pointer to what holds the map where the picture is drawn.
template <typename Map>
struct Layer {
  Map map{};
  std::string view_id{};  // the display's name of the view
  SplatCamera camera{};   // in the map's frame
  RenderSettings settings{};
  OrderBook::Choice order{};  // a sidecar's; without one, the renderer sorts
  MapState state{};           // of the map that the picture is to show; drawers fill it in
};

// Maps in one picture, sorted together; at least one. All layers have the same camera: only the
// frame that it is given in and its extent_scale differ. Splats of equal depth come in the order of
// the layers. What concerns the whole picture (precision, profile, interactive) is said by the
// first layer.
template <typename Map>
struct Picture {
  std::vector<Layer<Map>> layers;

  const Map& map() const { return layers.front().map; }
  const std::string& viewId() const { return layers.front().view_id; }
  const SplatCamera& camera() const { return layers.front().camera; }
  const RenderSettings& settings() const { return layers.front().settings; }
  // The given order; null: sorted by depth, or unsorted. An order is of one map alone.
  OrderPtr order() const { return layers.size() == 1 ? layers.front().order.order : nullptr; }
  // Whether splats are drawn in the order of their slots' numbers.
  bool unsorted() const { return layers.size() == 1 && settings().order == OrderSource::kOff; }
};

}  // namespace rosplat
