#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <string>
#include <thread>
#include <vector>

#include "imu_history.hpp"

namespace rosplat {

// Keeps the last seconds of a topic of IMU readings, in a thread of its own so that no rate of
// messages holds up the GUI.
class ImuReceiver {
 public:
  struct Snapshot {
    std::vector<ImuSample> samples;
    std::string frame_id;
    std::uint64_t received = 0;  // messages since the start
  };

  // Throws rclcpp's exceptions for a topic with an invalid name.
  ImuReceiver(const rclcpp::Node::SharedPtr& node, const std::string& topic, double window);
  ~ImuReceiver();

  void setWindow(double window);
  std::uint64_t received() const;
  Snapshot snapshot() const;

 private:
  void receive(const sensor_msgs::msg::Imu& message);

  rclcpp::CallbackGroup::SharedPtr group_;
  rclcpp::Subscription<sensor_msgs::msg::Imu>::SharedPtr subscription_;

  mutable std::mutex mutex_;  // guards history_, frame_id_, received_
  ImuHistory history_;
  std::string frame_id_;
  std::uint64_t received_ = 0;

  rclcpp::executors::SingleThreadedExecutor executor_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace rosplat
