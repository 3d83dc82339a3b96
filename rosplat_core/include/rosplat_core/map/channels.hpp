#pragma once

#include <cstddef>
#include <limits>
#include <string>
#include <vector>

namespace rosplat {

constexpr std::size_t kMostChannels = 8;  // as GaussianArray.MAX_CHANNELS

constexpr float kNoValue = std::numeric_limits<float>::quiet_NaN();

// What a map keeps of each splat beside what is drawn of it: a value, not finite where there is
// none.
struct Channel {
  std::string name;
  // Of the values that it has had since the map's last clear.
  float least = std::numeric_limits<float>::infinity();
  float most = -std::numeric_limits<float>::infinity();
  bool whole = true;  // all of them integers

  void widen(float value);
};

// The channels of a map that had some, once it is written with others, too. Throws BatchError for a
// name that is none or there twice, and for more than kMostChannels together.
std::vector<Channel> joined(std::vector<Channel> known, const std::vector<std::string>& names);
// Where a channel is; as many as there are where there is none.
std::size_t indexOf(const std::vector<Channel>& channels, const std::string& name);

}  // namespace rosplat
