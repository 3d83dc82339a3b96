#include "rosplat_ros/batches.hpp"

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/map_pull.hpp"
#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {

static_assert(kMaxSlots == rosplat_msgs::msg::GaussianArray::MAX_SLOTS);
static_assert(kMostGroups == rosplat_msgs::msg::GaussianArray::MAX_GROUPS);
static_assert(kMostChannels == rosplat_msgs::msg::GaussianArray::MAX_CHANNELS);
static_assert(SlotPage::kSlots == rosplat_msgs::msg::GaussianArray::SLOTS_PER_BLOCK);
static_assert(SlotPage::kSlots * MapPull<int>::kBlocks == kMaxSlots);

GaussianBatch toBatch(const rosplat_msgs::msg::GaussianArray& message, Arrival arrival) {
  GaussianBatch batch;
  batch.arrival = arrival;
  batch.map_id = message.map_id;
  batch.revision = message.revision;
  batch.operation = message.operation;
  batch.expected_slots = message.expected_slots;
  batch.first_slot = message.first_slot;
  batch.count = message.count;
  batch.slots = message.slots;
  batch.group = message.group;
  batch.groups = message.groups;
  for (const geometry_msgs::msg::Pose& pose : message.poses) {
    const auto& p = pose.position;
    const auto& q = pose.orientation;
    batch.poses.push_back({{p.x, p.y, p.z}, {q.x, q.y, q.z, q.w}});
  }
  batch.sh_degree = message.sh_degree;
  batch.format = message.format;
  batch.payload = message.payload;
  batch.model = message.model;
  batch.origin = {message.origin.x, message.origin.y, message.origin.z};
  batch.positions = message.positions;
  batch.orientations = message.orientations;
  batch.scales = message.scales;
  batch.opacities = message.opacities;
  batch.sh = message.sh;
  batch.channel_names = message.channel_names;
  batch.channels = message.channels;
  return batch;
}

}  // namespace rosplat
