#pragma once

#include <rclcpp/rclcpp.hpp>
#include <string>

namespace rosplat {

// The full name of the node that a publisher or subscription belongs to; empty where that is not
// known yet, for endpoints are heard of before their nodes.
std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint);

}  // namespace rosplat
