#pragma once

// Where the supported ROS 2 releases differ. Private: it is installed because rviz_gaussian_plugin
// compiles against it. What depends on rviz takes RVIZ_COMMON_VERSION from CMake: major * 10000 +
// minor * 100 + patch.

#include <rclcpp/version.h>

#include <chrono>
#include <exception>
#include <rclcpp/callback_group.hpp>
#include <rclcpp/qos.hpp>

namespace rosplat {

// What Node::create_service and AsyncParametersClient take.
#if RCLCPP_VERSION_MAJOR >= 17  // Iron
inline rclcpp::QoS serviceQos() { return rclcpp::ServicesQoS(); }
inline rclcpp::QoS parametersQos() { return rclcpp::ParametersQoS(); }
#else
inline rmw_qos_profile_t serviceQos() { return rmw_qos_profile_services_default; }
inline rmw_qos_profile_t parametersQos() { return rmw_qos_profile_parameters; }
#endif

// After clients, services or subscriptions of a group were destroyed, for whoever spins it.
inline void collectEntities([[maybe_unused]] rclcpp::CallbackGroup& group) noexcept {
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

// What a Display and a ViewController are updated with.
#ifdef RVIZ_COMMON_VERSION
#if RVIZ_COMMON_VERSION >= 150108  // Lyrical
using UpdateDuration = std::chrono::nanoseconds;
#else
using UpdateDuration = float;
#endif
#endif

}  // namespace rosplat
