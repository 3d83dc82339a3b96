#include "ros_graph.hpp"

namespace rosplat {

std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint) {
  const std::string& name = endpoint.node_name();
  // How rmw_dds_common and older middleware call a node that is not known yet.
  if (name.empty() || name == "_NODE_NAME_UNKNOWN_") return {};
  const std::string& space = endpoint.node_namespace();
  return (space == "/" ? "" : space) + "/" + name;
}

}  // namespace rosplat
