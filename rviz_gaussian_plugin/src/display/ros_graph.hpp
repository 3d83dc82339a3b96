#pragma once

#include <rmw/rmw.h>

#include <rclcpp/rclcpp.hpp>
#include <string>

namespace rosplat {

// The full name of the node that a publisher or subscription belongs to. Empty while that is
// unknown: discovery tells of endpoints before their nodes.
std::string nodeOf(const rclcpp::TopicEndpointInfo& endpoint);

// Whether Fast DDS, if it is the middleware, has another user's shared memory in a folder, which
// can't write to ours.
bool otherUserSharesMemory(const std::string& folder = "/dev/shm",
                           const std::string& middleware = rmw_get_implementation_identifier());

}  // namespace rosplat
