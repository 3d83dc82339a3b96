#pragma once

#include <chrono>
#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <rclcpp/rclcpp.hpp>
#include <string>
#include <vector>

#include "display_status.hpp"
#include "splat_scene.hpp"

namespace rosplat {

// Publishes a display's state on /diagnostics once a second, as docs/reference.md describes.
class Diagnostics {
 public:
  // topic: the map's, for the status name "NODE: TOPIC".
  Diagnostics(rclcpp::Node& node, const std::string& topic);

  // Does nothing before a second has passed. lines: of the display's Status, at least one.
  void publish(const std::vector<StatusLine>& lines, const SplatScene& scene, std::size_t views);

 private:
  rclcpp::Clock::SharedPtr clock_;
  rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr publisher_;
  diagnostic_msgs::msg::DiagnosticStatus status_;
  std::chrono::steady_clock::time_point published_;
};

}  // namespace rosplat
