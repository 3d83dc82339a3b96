#include "frames.hpp"

#include <cmath>
#include <rviz_common/frame_manager_iface.hpp>
#include <rviz_common/transformation/frame_transformer.hpp>
#include <string>
#include <tuple>

namespace rosplat {

namespace {

// Drops a leading slash, which tf2 doesn't know.
std::string bare(const std::string& frame) {
  return frame.substr(!frame.empty() && frame.front() == '/');
}

}  // namespace

std::optional<geometry_msgs::msg::Pose> inFixedFrame(rviz_common::FrameManagerIface& frames,
                                                     const geometry_msgs::msg::PoseStamped& pose) {
  geometry_msgs::msg::PoseStamped from = pose;
  const bool newest = from.header.stamp == builtin_interfaces::msg::Time();
  if (newest && frames.getSyncMode() != rviz_common::FrameManagerIface::SyncOff) {
    from.header.stamp = frames.getTime();
  }
  from.header.frame_id = bare(from.header.frame_id);
  try {
    const std::string fixed_frame = bare(frames.getFixedFrame());
    const auto there = frames.getTransformer()->transform(from, fixed_frame).pose;
    const auto& [x, y, z] = std::tie(there.position.x, there.position.y, there.position.z);
    if (std::isfinite(x + y + z)) return there;
  } catch (const rviz_common::transformation::FrameTransformerException&) {
    // The caller gets no pose.
  }
  return std::nullopt;
}

}  // namespace rosplat
