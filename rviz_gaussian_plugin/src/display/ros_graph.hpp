#pragma once

#include <rclcpp/rclcpp.hpp>
#include <string>

namespace rosplat {

// The full name of the node that a publisher or subscription belongs to. Empty while that is
// unknown: discovery tells of endpoints before their nodes.
std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint);

// Whether Fast DDS's shared memory in a folder is another user's, which can't write to ours.
bool otherUserSharesMemory(const std::string& folder = "/dev/shm");

}  // namespace rosplat
