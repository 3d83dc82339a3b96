#include "rosplat_core/views/channel_colouring.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr float kFarthest = 1e38f;  // limit of a gradient's ends, so that its range is finite

}  // namespace

ChannelColouring colouringOf(const std::vector<Channel>& channels, const RenderSettings& settings) {
  ChannelColouring colouring;
  const std::string& name = settings.channel;
  colouring.channel = name.empty() ? 0 : indexOf(channels, name);
  if (colouring.channel >= channels.size()) return colouring;
  const Channel& channel = channels[colouring.channel];
  const bool categories = settings.channel_colours == ChannelColours::kAuto
                              ? channel.whole
                              : settings.channel_colours == ChannelColours::kCategories;
  colouring.kind = categories ? kCategories : kGradient;
  auto [least, most] = settings.channel_range;
  if (least >= most) least = channel.least, most = channel.most;
  colouring.least = std::clamp(least, -kFarthest, kFarthest);
  colouring.most = std::clamp(most, -kFarthest, kFarthest);
  const float range = colouring.most - colouring.least;
  colouring.per_range = range > 0 ? 1 / range : 0;
  return colouring;
}

}  // namespace rosplat
