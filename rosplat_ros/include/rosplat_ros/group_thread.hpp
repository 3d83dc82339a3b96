#pragma once

// Private: it is installed because rviz_gaussian_plugin compiles against it.

#include <atomic>
#include <chrono>
#include <exception>
#include <rclcpp/rclcpp.hpp>
#include <thread>
#include <utility>

#include "rosplat_core/map/printable.hpp"
#include "rosplat_ros/node_interfaces.hpp"
#include "rosplat_ros/ros_versions.hpp"

namespace rosplat {

// Runs the callbacks of a group in a thread of its own, from start() to stop().
class GroupThread {
 public:
  GroupThread(const NodeInterfaces& node, rclcpp::CallbackGroup::SharedPtr group)
      : node_(node), group_(std::move(group)), executor_(optionsOf(node)) {
    executor_.add_callback_group(group_, node_.base);
  }
  ~GroupThread() { stop(); }
  GroupThread(const GroupThread&) = delete;
  GroupThread& operator=(const GroupThread&) = delete;

  void start() {
    stop_ = false;
    thread_ = std::thread([this] { spin(); });
  }
  void stop() {
    if (!thread_.joinable()) return;
    stop_ = true;
    executor_.cancel();
    thread_.join();
  }

  // Stops the thread within its scope. What the executor waits for, its thread holds, too: let go
  // meanwhile, it would end in that thread, while the owner makes or ends others of the node, for
  // which rcl has no lock. And while messages arrive, rclcpp's executor (Jazzy) may miss a
  // subscription that another thread makes, and never wait for it.
  struct Pause {
    explicit Pause(GroupThread& thread) : of(thread) { of.stop(); }
    ~Pause() {
      collectEntities(*of.group_);
      of.start();
    }
    Pause(const Pause&) = delete;
    Pause& operator=(const Pause&) = delete;

    GroupThread& of;
  };

 private:
  static rclcpp::ExecutorOptions optionsOf(const NodeInterfaces& node) {
    rclcpp::ExecutorOptions options;
    options.context = node.base->get_context();
    return options;
  }

  void spin() {
    rclcpp::Clock clock(RCL_STEADY_TIME);  // simulated time may stand still
    while (!stop_ && node_.base->get_context()->is_valid()) {
      try {
        executor_.spin_once(std::chrono::milliseconds(100));
      } catch (const std::exception& error) {  // memory may be lacking for a message, say
        RCLCPP_ERROR_THROTTLE(node_.logging->get_logger(), clock, 5000, "%s",
                              printable(error.what()).c_str());
      }
    }
  }

  NodeInterfaces node_;
  rclcpp::CallbackGroup::SharedPtr group_;
  rclcpp::executors::SingleThreadedExecutor executor_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace rosplat
