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
#define READ(field) batch.field = message.field;
  ROSPLAT_BATCH_FIELDS(READ)
  ROSPLAT_RECEIVED_ARRAYS(READ)
#undef READ
  batch.origin = {message.origin.x, message.origin.y, message.origin.z};
  for (const geometry_msgs::msg::Pose& pose : message.poses) {
    const auto& p = pose.position;
    const auto& q = pose.orientation;
    batch.poses.push_back({{p.x, p.y, p.z}, {q.x, q.y, q.z, q.w}});
  }
  return batch;
}

}  // namespace rosplat
