#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <rclcpp/rclcpp.hpp>
#include <string>

namespace rosplat {

// Has the parameter `backend` of whoever publishes a map's orders set, and of who comes after.
class SidecarSwitch {
 public:
  // What became of it, empty while nothing is asked for.
  struct Report {
    std::string text;
    bool failed = false;
  };

  // What others answer is heard in the group.
  SidecarSwitch(rclcpp::Node::SharedPtr node, std::string order_topic,
                rclcpp::CallbackGroup::SharedPtr group);

  // Empty: no more. From any thread, as report().
  void ask(const std::string& backend);
  Report report() const;
  // Tells who is there and was not told. Now and then, from a callback of the group.
  void tell();

 private:
  void note(const std::string& backend, const std::string& text, bool failed);

  rclcpp::Node::SharedPtr node_;
  std::string order_topic_;
  rclcpp::CallbackGroup::SharedPtr group_;
  std::shared_ptr<rclcpp::AsyncParametersClient> parameters_;  // of sidecar_
  std::string sidecar_;
  std::array<std::uint8_t, RMW_GID_STORAGE_SIZE> publisher_{};  // of sidecar_
  std::string told_;                                            // backend
  std::chrono::steady_clock::time_point told_at_;
  bool answered_ = false;

  mutable std::mutex mutex_;  // backend_, report_
  std::string backend_;       // that is asked for
  Report report_;
};

}  // namespace rosplat
