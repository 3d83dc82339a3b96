#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "rosplat_core/map/placement.hpp"

namespace rosplat {

constexpr std::uint32_t kMostGroups = 32768;  // as GaussianArray.MAX_GROUPS

// Where a frame is in another.
struct Pose {
  std::array<double, 3> position{};               // [m]
  std::array<double, 4> orientation{0, 0, 0, 1};  // quaternion x y z w of unit length
};

// Splats that move as one: one with position p is at pose (p + origin) in the map's frame.
struct Group {
  std::uint32_t number = 0;                     // chosen by the author
  Pose pose;                                    // of the group's frame in the map's
  Placement place;                              // the same as pose
  std::optional<std::array<double, 3>> origin;  // of the group's first splats [m]

  std::array<double, 3> originOrZero() const { return origin.value_or(std::array<double, 3>{}); }
  // A splat's position [m] and orientation (x y z w), in the map's frame.
  std::array<double, 3> inMap(const std::array<double, 3>& position) const;
  std::array<float, 4> inMap(const std::array<float, 4>& orientation) const;
};

// A group's new pose.
struct GroupMove {
  std::uint32_t group = 0;
  Pose pose;
};

// The groups of a map. Their numbers are below kMostGroups.
class Groups {
 public:
  // By index: 0, 1, 2, ... in the order in which they came. A group keeps its index.
  const std::vector<Group>& all() const { return groups_; }
  // Null for a group that was never named.
  const Group* find(std::uint32_t number) const;

  // Makes room for so many new groups: move() and write() of these need no memory.
  void makeRoom(std::size_t more);
  bool hasRoom(std::size_t more) const {
    return more == 0 || (!indices_.empty() && groups_.size() + more <= groups_.capacity());
  }
  void move(const GroupMove& move);
  // Notes that splats are written to a group: the first ones set its origin. Returns its index.
  std::uint32_t write(std::uint32_t number, const std::array<double, 3>& origin);

 private:
  std::uint32_t indexOf(std::uint32_t number);

  std::vector<Group> groups_;
  std::vector<std::uint16_t> indices_;  // by number; empty without groups
};

}  // namespace rosplat
