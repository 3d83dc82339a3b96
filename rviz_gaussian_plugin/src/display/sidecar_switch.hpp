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

// Sets the parameter `backend` of all nodes that publish a map's orders, now or later.
class SidecarSwitch {
 public:
  // The result, empty while nothing is asked for.
  struct Report {
    std::string text;
    bool failed = false;
  };

  // Answers call back in the group, in another thread.
  SidecarSwitch(rclcpp::Node::SharedPtr node, std::string order_topic,
                rclcpp::CallbackGroup::SharedPtr group);

  // Asks all sorters for a backend; empty: stops that. From any thread, as report().
  void ask(const std::string& backend);
  Report report() const;
  // Asks sorters that weren't asked yet or didn't answer within 3 s. Call it now and then, from the
  // thread that makes the node's clients. Returns the clients of sorters that are gone: let them go
  // while nobody spins the group, then collectEntities() of it.
  using Clients = std::vector<std::shared_ptr<rclcpp::AsyncParametersClient>>;
  Clients askSorters();

 private:
  using Gid = std::array<std::uint8_t, RMW_GID_STORAGE_SIZE>;  // of a publisher

  struct Sidecar {
    std::string name;
    std::shared_ptr<rclcpp::AsyncParametersClient> parameters;
    std::string asked_for;  // backend
    std::chrono::steady_clock::time_point asked_at;
    std::optional<Report> answer;
  };

  // To be called with mutex_ locked.
  Clients forgetGone(const std::vector<rclcpp::TopicEndpointInfo>& sorters);
  void askSorter(const rclcpp::TopicEndpointInfo& sorter);
  void updateReport();

  rclcpp::Node::SharedPtr node_;
  std::string order_topic_;
  rclcpp::CallbackGroup::SharedPtr group_;

  mutable std::mutex mutex_;  // of all members below
  std::map<Gid, Sidecar> sidecars_;
  std::string backend_;  // that the user asks for
  Report report_;
};

}  // namespace rosplat
