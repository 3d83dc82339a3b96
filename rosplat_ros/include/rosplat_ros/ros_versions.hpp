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

// Qualities of service in the types that Node::create_service and AsyncParametersClient take.
#if RCLCPP_VERSION_MAJOR >= 17  // Iron
inline rclcpp::QoS serviceQos() { return rclcpp::ServicesQoS(); }
inline rclcpp::QoS parametersQos() { return rclcpp::ParametersQoS(); }
#else
inline rmw_qos_profile_t serviceQos() { return rmw_qos_profile_services_default; }
inline rmw_qos_profile_t parametersQos() { return rmw_qos_profile_parameters; }
#endif

// Tells the executor of a group that clients, services or subscriptions of it were destroyed.
inline void collectEntities([[maybe_unused]] rclcpp::CallbackGroup& group) noexcept {
#if RCLCPP_VERSION_MAJOR >= 28  // Jazzy
  // Since Jazzy an executor looks for its entities only when one was created. Until then it takes
  // the entities behind a destroyed one for their neighbours, and what they receive waits.
  try {
    group.trigger_notify_guard_condition();
  } catch (const std::exception&) {
    // ROS was shut down: no executor spins the group.
  }
#endif
}

// The type of the time step that update() of a Display or a ViewController gets.
#ifdef RVIZ_COMMON_VERSION
#if RVIZ_COMMON_VERSION >= 150108  // Lyrical
using UpdateDuration = std::chrono::nanoseconds;
#else
using UpdateDuration = float;
#endif
#endif

}  // namespace rosplat
