#include "ros_graph.hpp"

#include <rclcpp/version.h>

#include <exception>

namespace rosplat {

std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint) {
  const std::string& name = endpoint.node_name();
  // As rmw_dds_common and older middleware say it.
  if (name.empty() || name == "_NODE_NAME_UNKNOWN_") return {};
  const std::string& space = endpoint.node_namespace();
  return (space == "/" ? "" : space) + "/" + name;
}

void collectEntities([[maybe_unused]] rclcpp::CallbackGroup& group) noexcept {
#if RCLCPP_VERSION_MAJOR >= 28  // Jazzy
  // There an executor looks for its entities only when one was created. Until then it takes those
  // behind a destroyed one for their neighbours, and what they receive waits.
  try {
    group.trigger_notify_guard_condition();
  } catch (const std::exception&) {
    // ROS has ended: nobody spins it.
  }
#endif
}

}  // namespace rosplat
