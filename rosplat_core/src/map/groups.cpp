#include "rosplat_core/map/groups.hpp"

#include <algorithm>

namespace rosplat {

namespace {
constexpr std::uint16_t kUnnamed = 0xffff;
static_assert(kMostGroups <= kUnnamed);
}  // namespace

std::array<double, 3> Group::inMap(const std::array<double, 3>& position) const {
  const std::array<double, 3> from = originOrZero();
  return place({position[0] + from[0], position[1] + from[1], position[2] + from[2]});
}

std::array<float, 4> Group::inMap(const std::array<float, 4>& orientation) const {
  const auto& [ax, ay, az, aw] = pose.orientation;
  const std::array<double, 4> b{orientation[0], orientation[1], orientation[2], orientation[3]};
  return {static_cast<float>(aw * b[0] + ax * b[3] + ay * b[2] - az * b[1]),
          static_cast<float>(aw * b[1] - ax * b[2] + ay * b[3] + az * b[0]),
          static_cast<float>(aw * b[2] + ax * b[1] - ay * b[0] + az * b[3]),
          static_cast<float>(aw * b[3] - ax * b[0] - ay * b[1] - az * b[2])};
}

const Group* Groups::find(std::uint32_t number) const {
  const bool known = number < indices_.size() && indices_[number] != kUnnamed;
  return known ? &groups_[indices_[number]] : nullptr;
}

void Groups::makeRoom(std::size_t more) {
  if (more > 0 && indices_.empty()) indices_.assign(kMostGroups, kUnnamed);
  if (const std::size_t all = groups_.size() + more; all > groups_.capacity()) {
    groups_.reserve(std::max(all, 2 * groups_.size()));
  }
}

void Groups::move(const GroupMove& move) {
  Group& group = groups_[indexOf(move.group)];
  group.pose = move.pose;
  group.place = makePlacement(move.pose.position, move.pose.orientation);
}

std::uint32_t Groups::write(std::uint32_t number, const std::array<double, 3>& origin) {
  const std::uint32_t index = indexOf(number);
  if (!groups_[index].origin) groups_[index].origin = origin;
  return index;
}

std::uint32_t Groups::indexOf(std::uint32_t number) {
  makeRoom(1);
  std::uint16_t& index = indices_[number];
  if (index == kUnnamed) {
    index = static_cast<std::uint16_t>(groups_.size());
    groups_.emplace_back().number = number;
  }
  return index;
}

}  // namespace rosplat
