#include "gpu/view_block.hpp"

#include <algorithm>

#include "gl/shaders.hpp"
#include "map/sorter_view.hpp"

namespace rosplat {

namespace {

std::array<float, 2> floats(double x, double y) {
  return {static_cast<float>(x), static_cast<float>(y)};
}

}  // namespace

ViewBlock::ViewBlock(const Frame& frame) {
  const SplatCamera& camera = frame.camera;
  const RenderSettings& settings = frame.settings;
  const MapState& map = frame.map;
  const rosplat_sorter::View view = sorterView(camera, {}, 1.0);  // where groups are is their own
  orthographic = view.orthographic;
  clip = {view.near_clip, view.far_clip};
  focal = {view.fx, view.fy};
  offset = {view.offset_x, view.offset_y};
  half_size = {view.half_width, view.half_height};
  slope = {view.slope_x, view.slope_y};
  clip_to_box = settings.clip_box.enabled;
  box_size = settings.clip_box.size;
  principal_point = floats(camera.cx, camera.cy);
  const SplatCamera::Whole whole = camera.whole();
  whole_principal_point = floats(whole.cx, whole.cy);
  whole_picture = floats(whole.width, whole.height);
  picture = {camera.width, camera.height};
  tiles = {tilesIn(camera.width), tilesIn(camera.height)};
  ndc_depth = floats(camera.ndc_scale, camera.ndc_offset);
  mode = static_cast<int>(settings.mode);
  depth_range = settings.depth_range;
  scale_modifier = settings.scale;
  opacity_modifier = settings.opacity;
  near_fade = settings.near_fade;
  sh_degree = std::min(frame.store.shDegree(), settings.max_sh_degree);
  only_band = settings.only_band;
  antialiased = settings.antialiasing == Antialiasing::kAsTrained
                    ? map.antialiased
                    : settings.antialiasing == Antialiasing::kOn;
  top_first = frame.top_first;
  now = static_cast<float>(frame.now);
  age_range = settings.age_range;
  const ChannelColouring channel = colouringOf(map.channels, settings);
  channel_least = channel.least;
  channel_most = channel.most;
  channel_per_range = channel.per_range;
  channel_colours = channel.channel < frame.store.channels() ? channel.kind : 0;
  const Cut shares = frame.cut(camera, {});
  cut = frame.cuts();
  cut_focal = static_cast<float>(shares.focal);
  rise = floats(shares.from, frame.cuts() ? 1 / (shares.to - shares.from) : 0);
}

}  // namespace rosplat
