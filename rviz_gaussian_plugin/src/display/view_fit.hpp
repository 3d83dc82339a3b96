#pragma once

#include <array>
#include <chrono>
#include <geometry_msgs/msg/pose.hpp>
#include <optional>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/msg/first_view.hpp>
#include <string>
#include <vector>

namespace rviz_common {
class FrameManagerIface;
class ViewManager;
}  // namespace rviz_common

namespace rosplat {

// A camera that orbits a target with z up, as rviz's Orbit does. [m, rad]
struct OrbitView {
  std::array<double, 3> target{};
  double distance = 1, yaw = 0, pitch = 0;
  bool inside = false;  // the map surrounds the camera
};

// The orbit of a camera at `eye`, farther away for a picture narrower than `width`: both that and
// the aspect are widths in heights. [m]
OrbitView orbitOf(const std::array<double, 3>& eye, const std::array<double, 3>& target,
                  double width, double aspect);

// The orbit whose picture the bulk of positions, at least one, fits; few far ones don't count. [m]
OrbitView orbitAround(std::vector<std::array<double, 3>> positions, double aspect);

// Fits rviz's view to a map: to the first view that the map's publisher offers at
// <topic>/first_view, or, where none comes, to what there is of the map. All calls, and the
// callbacks of the node, are in rviz's render thread.
class ViewFit {
 public:
  // Throws rclcpp's exceptions for a topic with an invalid name.
  ViewFit(const rclcpp::Node::SharedPtr& node, const std::string& topic);

  // The view to show once the map is there: none until it is offered, or waited for in vain.
  // positions: of a sample of the map, in `frame` [m]; aspect: of rviz's picture, width / height.
  std::optional<OrbitView> find(const std::string& frame,
                                const std::vector<std::array<double, 3>>& positions,
                                rviz_common::FrameManagerIface& frames, double aspect);

 private:
  rclcpp::Subscription<rosplat_msgs::msg::FirstView>::SharedPtr subscription_;
  std::optional<rosplat_msgs::msg::FirstView> offered_;
  std::optional<std::chrono::steady_clock::time_point> since_;  // there has been a map
};

// Moves rviz's Orbit view, or turns another one to the target. From inside a map, the Fly view
// takes its place: an Orbit would carry the camera through the walls.
void moveTo(const OrbitView& view, rviz_common::ViewManager& views);

}  // namespace rosplat
