#pragma once

#include <chrono>
#include <geometry_msgs/msg/pose_stamped.hpp>
#include <nav_msgs/msg/path.hpp>
#include <rclcpp/rclcpp.hpp>
#include <string>

namespace rosplat {

// Publishes the pose of a camera, and the path it has taken, for other displays.
class CameraTrail {
 public:
  // On <topic>/pose and <topic>/path.
  CameraTrail(rclcpp::Node& node, const std::string& topic);

  void publish(const geometry_msgs::msg::PoseStamped& pose);

 private:
  rclcpp::Publisher<geometry_msgs::msg::PoseStamped>::SharedPtr pose_publisher_;
  rclcpp::Publisher<nav_msgs::msg::Path>::SharedPtr path_publisher_;
  nav_msgs::msg::Path path_;
  bool grew_ = false;  // since path_ was published
  std::chrono::steady_clock::time_point published_;
};

}  // namespace rosplat
