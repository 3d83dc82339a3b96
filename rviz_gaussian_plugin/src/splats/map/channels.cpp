#include "map/channels.hpp"

#include <algorithm>
#include <cmath>

#include "map/gaussian_map.hpp"
#include "map/render_settings.hpp"
#include "rosplat_sorter/splat_arrays.hpp"

namespace rosplat {

namespace {

constexpr float kFarthest = 1e38f;  // ends of a gradient, so that its range is finite

}  // namespace

void Channel::widen(float value) {
  if (!std::isfinite(value)) return;
  least = std::min(least, value);
  most = std::max(most, value);
  whole = whole && std::floor(value) == value;
}

std::vector<Channel> joined(std::vector<Channel> known, const std::vector<std::string>& names) {
  for (auto name = names.begin(); name != names.end(); ++name) {
    if (!isChannelName(*name)) {
      throw BatchError("channel_names: number " + std::to_string(name - names.begin()) +
                       " is no name: 1 to 64 characters of ASCII, no spaces");
    }
    if (std::find(names.begin(), name, *name) != name) {
      throw BatchError("channel_names: '" + *name + "' is there twice");
    }
    if (indexOf(known, *name) < known.size()) continue;
    if (known.size() == kMostChannels) {
      throw BatchError("channel_names: '" + *name + "' is beyond the " +
                       std::to_string(kMostChannels) + " channels that a map may have");
    }
    known.emplace_back().name = *name;
  }
  return known;
}

std::size_t indexOf(const std::vector<Channel>& channels, const std::string& name) {
  const auto found = std::find_if(channels.begin(), channels.end(),
                                  [&](const Channel& channel) { return channel.name == name; });
  return static_cast<std::size_t>(found - channels.begin());
}

ChannelColouring colouringOf(const std::vector<Channel>& channels, const RenderSettings& settings) {
  ChannelColouring colouring;
  const std::string& name = settings.channel;
  colouring.channel = name.empty() ? 0 : indexOf(channels, name);
  if (colouring.channel >= channels.size()) return colouring;
  const Channel& channel = channels[colouring.channel];
  const bool categories = settings.channel_colours == ChannelColours::kAuto
                              ? channel.whole
                              : settings.channel_colours == ChannelColours::kCategories;
  colouring.kind = categories ? ChannelColouring::kCategories : ChannelColouring::kGradient;
  auto [least, most] = settings.channel_range;
  if (least >= most) least = channel.least, most = channel.most;
  colouring.least = std::clamp(least, -kFarthest, kFarthest);
  colouring.most = std::clamp(most, -kFarthest, kFarthest);
  const float range = colouring.most - colouring.least;
  colouring.per_range = range > 0 ? 1 / range : 0;
  return colouring;
}

}  // namespace rosplat
