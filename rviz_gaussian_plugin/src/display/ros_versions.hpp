#pragma once

// Where the supported ROS 2 releases differ. CMake defines RVIZ_COMMON_VERSION as
// major * 10000 + minor * 100 + patch.

#include <rclcpp/version.h>

#include <chrono>
#include <rclcpp/qos.hpp>

namespace rosplat {

#if RVIZ_COMMON_VERSION >= 150108  // Lyrical
using UpdateDuration = std::chrono::nanoseconds;
#else
using UpdateDuration = float;
#endif

// What Node::create_service and AsyncParametersClient take.
#if RCLCPP_VERSION_MAJOR >= 17  // Iron
inline rclcpp::QoS serviceQos() { return rclcpp::ServicesQoS(); }
inline rclcpp::QoS parametersQos() { return rclcpp::ParametersQoS(); }
#else
inline rmw_qos_profile_t serviceQos() { return rmw_qos_profile_services_default; }
inline rmw_qos_profile_t parametersQos() { return rmw_qos_profile_parameters; }
#endif

}  // namespace rosplat
