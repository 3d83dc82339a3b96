#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "gl/shaders.hpp"
#include "gl/stopwatch.hpp"
#include "gpu/node_store.hpp"
#include "gpu/slot_store.hpp"
#include "rosplat_core/levels/cut.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in a frame, and how it is drawn there.
struct FrameLayer {
  const SlotStore& store;
  const NodeStore* nodes;     // of the levels of detail; null without levels
  const SplatCamera& camera;  // in the map's frame
  const MapState& map;
  const RenderSettings& settings;
  double error = 0;  // width up to which nodes stand for splats, 0: no nodes [px]

  Model model() const { return settings.drawnModel(map.model); }
  Shapes shapes() const {
    const Model drawn = model();
    return drawn == Model::kDisc  ? Shapes::kDiscs
           : drawn == Model::kRay ? Shapes::kRays
                                  : Shapes::kEllipses;
  }
  bool cuts() const { return nodes && error > 0; }
  // seen_from: the camera in the frame of a group; origin: that of the group.
  Cut cut(const SplatCamera& seen_from, const std::array<double, 3>& origin) const {
    return {seen_from, origin, error, settings.blendsLevels()};
  }
};

// What is drawn, and how.
struct Frame {
  // At least one. All cameras are one camera: only the frame that it is given in and its
  // extent_scale differ. Splats of the same depth come in the order of the layers.
  std::vector<FrameLayer> layers;
  OrderPtr order;  // of the only layer; null: sorted here by depth, with ties as in the sorters
  bool top_first;  // the target's first row is the picture's top
  double now;      // the clock of `change` in packed_slot.hpp
  gl::Stopwatch& stopwatch;
  bool depths = false;  // depths are blended, too: as splat_depths.glsl has them

  const SplatCamera& camera() const { return layers.front().camera; }
  Shapes shapes() const {
    Shapes most = Shapes::kEllipses;
    for (const FrameLayer& layer : layers) most = std::max(most, layer.shapes());
    return most;
  }
  bool cuts() const {
    return std::any_of(layers.begin(), layers.end(),
                       [](const auto& layer) { return layer.cuts(); });
  }
};

}  // namespace rosplat
