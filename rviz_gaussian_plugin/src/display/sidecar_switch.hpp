#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <rclcpp/rclcpp.hpp>
#include <string>
#include <vector>

namespace rosplat {

// Has the parameter `backend` of all who publish a map's orders set, and of who comes after.
class SidecarSwitch {
 public:
  // The result, empty while nothing is asked for.
  struct Report {
    std::string text;
    bool failed = false;
  };

  // Answers are heard in the group, by another thread.
  SidecarSwitch(rclcpp::Node::SharedPtr node, std::string order_topic,
                rclcpp::CallbackGroup::SharedPtr group);

  // Asks all sorters for a backend; empty: stops that. From any thread, as report().
  void ask(const std::string& backend);
  Report report() const;
  // Asks sorters that weren't asked yet. Call it now and then, from the thread that makes the
  // node's clients.
  void tell();

 private:
  using Gid = std::array<std::uint8_t, RMW_GID_STORAGE_SIZE>;  // of a publisher

  struct Sidecar {
    std::string name;
    std::shared_ptr<rclcpp::AsyncParametersClient> parameters;
    std::string told;  // backend
    std::chrono::steady_clock::time_point told_at;
    std::optional<Report> answer;
  };

  // All with the mutex locked.
  bool forgetGone(const std::vector<rclcpp::TopicEndpointInfo>& sorters);
  void tell(const rclcpp::TopicEndpointInfo& sorter);
  void note();

  rclcpp::Node::SharedPtr node_;
  std::string order_topic_;
  rclcpp::CallbackGroup::SharedPtr group_;

  mutable std::mutex mutex_;  // what follows
  std::map<Gid, Sidecar> sidecars_;
  std::string backend_;  // that is asked for
  Report report_;
};

}  // namespace rosplat
