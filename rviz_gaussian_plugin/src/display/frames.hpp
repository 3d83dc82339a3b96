#pragma once

#include <geometry_msgs/msg/pose_stamped.hpp>
#include <optional>

namespace rviz_common {
class FrameManagerIface;
}

namespace rosplat {

// Where a pose is in rviz's Fixed Frame, at its stamp or, without one, now; nothing where TF
// doesn't say. As FrameManagerIface::transform(), whose answers are floats: a quarter of a metre
// apart at 4,500 km.
std::optional<geometry_msgs::msg::Pose> inFixedFrame(rviz_common::FrameManagerIface& frames,
                                                     const geometry_msgs::msg::PoseStamped& pose);

}  // namespace rosplat
