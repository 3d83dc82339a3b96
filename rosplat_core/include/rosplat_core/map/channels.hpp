#pragma once

#include <cstddef>
#include <limits>
#include <string>
#include <vector>

namespace rosplat {

constexpr std::size_t kMostChannels = 8;  // as GaussianArray.MAX_CHANNELS

constexpr float kNoValue = std::numeric_limits<float>::quiet_NaN();

// A value that a map keeps of each splat beside its shape and colour; not finite: no value.
struct Channel {
  std::string name;
  // Bounds of all finite values since the map's last clear.
  float least = std::numeric_limits<float>::infinity();
  float most = -std::numeric_limits<float>::infinity();
  bool whole = true;  // all of these values are integers

  void widen(float value);
};

// Returns a map's known channels and those of a batch's names. Throws BatchError for an invalid or
// repeated name, and for more than kMostChannels together.
std::vector<Channel> joined(std::vector<Channel> known, const std::vector<std::string>& names);
// Index of a channel; channels.size() if none has that name.
std::size_t indexOf(const std::vector<Channel>& channels, const std::string& name);

}  // namespace rosplat
