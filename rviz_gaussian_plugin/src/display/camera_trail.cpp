#include "camera_trail.hpp"

namespace rosplat {

namespace {
using namespace std::chrono_literals;

constexpr std::size_t kLongestPath = 10000;
constexpr auto kPathPeriod = 200ms;
}  // namespace

CameraTrail::CameraTrail(rclcpp::Node& node, const std::string& topic) {
  const auto qos = rclcpp::QoS(1).transient_local();
  rclcpp::PublisherOptions options;
  options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
  pose_publisher_ =
      node.create_publisher<geometry_msgs::msg::PoseStamped>(topic + "/pose", qos, options);
  path_publisher_ = node.create_publisher<nav_msgs::msg::Path>(topic + "/path", qos, options);
}

void CameraTrail::publish(const geometry_msgs::msg::PoseStamped& pose) {
  pose_publisher_->publish(pose);
  if (path_.header.frame_id != pose.header.frame_id) path_.poses.clear();
  path_.header = pose.header;
  if (path_.poses.empty() || path_.poses.back().pose != pose.pose) {
    if (path_.poses.size() >= kLongestPath) path_.poses.erase(path_.poses.begin());
    path_.poses.push_back(pose);
    grew_ = true;
  }
  const auto now = std::chrono::steady_clock::now();
  if (!grew_ || now - published_ < kPathPeriod) return;
  path_publisher_->publish(path_);
  published_ = now;
  grew_ = false;
}

}  // namespace rosplat
