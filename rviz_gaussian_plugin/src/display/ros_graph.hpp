#pragma once

#include <rclcpp/rclcpp.hpp>
#include <string>

namespace rosplat {

// The full name of the node that a publisher or subscription belongs to. Empty while that is
// unknown: discovery tells of endpoints before their nodes.
std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint);

}  // namespace rosplat
