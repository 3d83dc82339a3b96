#pragma once

#include <cstddef>
#include <vector>

#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/views/render_settings.hpp"

namespace rosplat {

// How the values of a channel become colours.
struct ChannelColouring {
  ChannelKind kind = kNoColours;  // without the channel: drawn like slots without a value
  std::size_t channel = 0;
  float least = 0, most = 0;  // ends of a gradient
  float per_range = 0;        // 1 / (most - least)
};
ChannelColouring colouringOf(const std::vector<Channel>& channels, const RenderSettings& settings);

}  // namespace rosplat
