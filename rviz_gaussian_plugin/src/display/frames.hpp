#pragma once

#include <geometry_msgs/msg/pose_stamped.hpp>
#include <optional>

namespace rviz_common {
class FrameManagerIface;
}

namespace rosplat {

// Transforms a pose to rviz's Fixed Frame, at its stamp or, without one, now; none if TF can't.
// Used instead of FrameManagerIface::transform(), whose float results are a quarter of a metre
// apart at 4,500 km.
std::optional<geometry_msgs::msg::Pose> inFixedFrame(rviz_common::FrameManagerIface& frames,
                                                     const geometry_msgs::msg::PoseStamped& pose);

}  // namespace rosplat
