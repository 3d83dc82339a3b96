#include "imu_receiver.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <exception>
#include <limits>

namespace rosplat {

namespace {

using namespace std::chrono_literals;

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

ImuSample toSample(const sensor_msgs::msg::Imu& message) {
  const auto& a = message.linear_acceleration;
  const auto& w = message.angular_velocity;
  ImuSample sample;
  sample.stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec;
  sample.axes = {a.x, a.y, a.z, w.x, w.y, w.z};
  for (double& value : sample.axes) {
    if (!std::isfinite(value)) value = kUnknown;
  }
  // The message's mark for a quantity that the sensor doesn't measure.
  const auto axes = sample.axes.begin();
  if (message.linear_acceleration_covariance[0] == -1) std::fill_n(axes, 3, kUnknown);
  if (message.angular_velocity_covariance[0] == -1) std::fill_n(axes + 3, 3, kUnknown);
  return sample;
}

}  // namespace

ImuReceiver::ImuReceiver(const rclcpp::Node::SharedPtr& node, const std::string& topic,
                         double window)
    : history_(window) {
  group_ = node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false);
  rclcpp::SubscriptionOptions options;
  options.callback_group = group_;
  // Best effort and volatile match any publisher; deep enough for a burst.
  subscription_ = node->create_subscription<sensor_msgs::msg::Imu>(
      topic, rclcpp::SensorDataQoS(rclcpp::KeepLast(100)),
      [this](sensor_msgs::msg::Imu::ConstSharedPtr message) { receive(*message); }, options);
  executor_.add_callback_group(group_, node->get_node_base_interface());
  thread_ = std::thread([this, topic, logger = node->get_logger()] {
    rclcpp::Clock steady_clock(RCL_STEADY_TIME);  // simulated time may stand still
    while (!stop_ && rclcpp::ok()) {
      try {
        executor_.spin_once(100ms);
      } catch (const std::exception& error) {  // memory may be lacking for a message, say
        RCLCPP_ERROR_THROTTLE(logger, steady_clock, 5000, "%s: %s", topic.c_str(), error.what());
      }
    }
  });
}

ImuReceiver::~ImuReceiver() {
  stop_ = true;
  executor_.cancel();
  thread_.join();
}

void ImuReceiver::receive(const sensor_msgs::msg::Imu& message) {
  const std::lock_guard lock(mutex_);
  history_.add(toSample(message));
  frame_id_ = message.header.frame_id;
  ++received_;
}

void ImuReceiver::setWindow(double window) {
  const std::lock_guard lock(mutex_);
  history_.setWindow(window);
}

std::uint64_t ImuReceiver::received() const {
  const std::lock_guard lock(mutex_);
  return received_;
}

ImuReceiver::Snapshot ImuReceiver::snapshot() const {
  const std::lock_guard lock(mutex_);
  const auto& samples = history_.samples();
  return {{samples.begin(), samples.end()}, frame_id_, received_};
}

}  // namespace rosplat
