#include "gpu/view_block.hpp"

#include <algorithm>

#include "gl/shaders.hpp"
#include "rosplat_core/views/channel_colouring.hpp"
#include "rosplat_core/views/sort_view.hpp"

namespace rosplat {

namespace {

std::array<float, 2> floats(double x, double y) {
  return {static_cast<float>(x), static_cast<float>(y)};
}

// Returns the kind that splats are blended as; splat_common.glsl has the same numbers.
std::uint32_t kindOf(const RenderSettings& settings) {
  constexpr std::uint32_t kGaussian = 0, kFlat = 1, kShaded = 2, kByDepth = 3;
  if (settings.mode == DrawMode::kFlatBall) return kFlat;
  if (settings.mode == DrawMode::kGaussianBall) return kShaded;
  return settings.mode == DrawMode::kDepth && settings.depth_range.empty() ? kByDepth : kGaussian;
}

}  // namespace

ViewBlock::ViewBlock(const Frame& frame) {
  const SplatCamera& camera = frame.camera();
  const SortView view = sortView(camera, {}, 1.0);  // splat_groups.glsl has the groups' poses
  clip = {view.near_clip, view.far_clip};
  focal = {view.fx, view.fy};
  offset = {view.offset_x, view.offset_y};
  half_size = {view.half_width, view.half_height};
  principal_point = floats(camera.cx, camera.cy);
  const SplatCamera::Whole whole = camera.whole();
  whole_principal_point = floats(whole.cx, whole.cy);
  whole_picture = floats(whole.width, whole.height);
  ndc_depth = floats(camera.ndc_scale, camera.ndc_offset);
  picture = {camera.width, camera.height};
  tiles = {tilesIn(camera.width), tilesIn(camera.height)};
  orthographic = view.orthographic;
  top_first = frame.top_first;
  cut = frame.cuts();
  now = static_cast<float>(frame.now);
}

MapBlock::MapBlock(const FrameLayer& layer) : SplatSettings(layer.settings) {
  const RenderSettings& settings = layer.settings;
  const SortView view = sortView(layer.camera, {}, 1.0);
  box_size = settings.clip_box.size;
  clip_to_box = settings.clip_box.enabled;
  slope = {view.slope_x, view.slope_y};
  kind = kindOf(settings);
  sh_degree = std::min(layer.store.shDegree(), settings.max_sh_degree);
  model = static_cast<std::int32_t>(layer.model());
  const Cut shares = layer.cut(layer.camera, {});
  cut = layer.cuts();
  cut_focal = static_cast<float>(shares.focal);
  rise = floats(shares.from, layer.cuts() ? 1 / (shares.to - shares.from) : 0);
  const ChannelColouring channel = colouringOf(layer.map.channels, settings);
  channel_least = channel.least;
  channel_most = channel.most;
  channel_per_range = channel.per_range;
  channel_colours = channel.channel < layer.store.channels() ? channel.kind : 0;
}

}  // namespace rosplat
