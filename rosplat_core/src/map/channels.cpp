#include "rosplat_core/map/channels.hpp"

#include <algorithm>
#include <cmath>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/slots/splat_arrays.hpp"

namespace rosplat {

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

}  // namespace rosplat
