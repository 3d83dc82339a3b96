#include "diagnostics.hpp"

#include <unistd.h>

#include <algorithm>
#include <fstream>

#include "rosplat_core/map/printable.hpp"

namespace rosplat {

namespace {

constexpr std::chrono::seconds kPeriod(1);

std::size_t residentBytes() {
  std::size_t size = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> size >> resident;  // proc(5)
  return resident * static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
}

}  // namespace

Diagnostics::Diagnostics(rclcpp::Node& node, const std::string& topic) : clock_(node.get_clock()) {
  rclcpp::PublisherOptions options;
  options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
  publisher_ = node.create_publisher<diagnostic_msgs::msg::DiagnosticArray>(
      "/diagnostics", rclcpp::QoS(1), options);
  status_.name = std::string(node.get_fully_qualified_name()).substr(1) + ": " + topic;
  char host[256] = {};
  gethostname(host, sizeof(host) - 1);
  status_.hardware_id = host;
}

void Diagnostics::publish(const std::vector<StatusLine>& lines, const SplatScene& scene,
                          std::size_t views) {
  const auto now = std::chrono::steady_clock::now();
  if (now - published_ < kPeriod) return;
  published_ = now;
  const StatusLine& worst = *std::max_element(
      lines.begin(), lines.end(), [](const auto& a, const auto& b) { return a.level < b.level; });
  status_.level = static_cast<std::uint8_t>(worst.level);  // 0 to 2 in both
  status_.message = printable(worst.name + ": " + worst.text);
  status_.values.clear();
  const auto say = [this](const char* key, const std::string& value) {
    diagnostic_msgs::msg::KeyValue said;
    said.key = key;
    said.value = printable(value);
    status_.values.push_back(std::move(said));
  };
  const MapState map = scene.state();
  const DrawnBytes bytes = scene.bytes();
  say("Map", map.id);
  say("Revision", std::to_string(map.revision));
  say("Splats", std::to_string(map.splats));
  say("Backlog (bytes)", std::to_string(scene.backlog().bytes));
  say("Batches missed", std::to_string(map.missed));
  say("Splats dropped", std::to_string(map.dropped));
  say("Views", std::to_string(views));
  say("GPU memory (bytes)", std::to_string(bytes.gpu + bytes.shared_gpu));
  say("Memory (bytes)", std::to_string(residentBytes()));
  diagnostic_msgs::msg::DiagnosticArray message;
  message.header.stamp = clock_->now();
  message.status.push_back(status_);
  publisher_->publish(message);
}

}  // namespace rosplat
