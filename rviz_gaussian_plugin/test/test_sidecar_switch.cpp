#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/msg/splat_order.hpp>
#include <string>
#include <thread>

#include "../src/display/sidecar_switch.hpp"
#include "rosplat_ros/ros_versions.hpp"

namespace rosplat {

namespace {

using namespace std::chrono_literals;

constexpr const char* kOrders = "/switched/order";

// A sorter, as far as it can be switched.
class Sorter {
 public:
  explicit Sorter(const std::string& name)
      : node_(std::make_shared<rclcpp::Node>(name)),
        orders_(node_->create_publisher<rosplat_msgs::msg::SplatOrder>(kOrders, 1)) {
    node_->declare_parameter("backend", "auto");
    refusing_ = node_->add_on_set_parameters_callback([](const auto& parameters) {
      rcl_interfaces::msg::SetParametersResult result;
      result.successful = parameters.front().as_string() != "abacus";
      result.reason = "unknown backend";
      return result;
    });
    executor_.add_node(node_);
  }

  std::string backend() {
    executor_.spin_some();
    return node_->get_parameter("backend").as_string();
  }

 private:
  rclcpp::Node::SharedPtr node_;
  rclcpp::Publisher<rosplat_msgs::msg::SplatOrder>::SharedPtr orders_;
  rclcpp::node_interfaces::OnSetParametersCallbackHandle::SharedPtr refusing_;
  rclcpp::executors::SingleThreadedExecutor executor_;
};

class SidecarSwitchTest : public testing::Test {
 protected:
  static void SetUpTestSuite() { rclcpp::init(0, nullptr); }
  static void TearDownTestSuite() { rclcpp::shutdown(); }

  SidecarSwitchTest()
      : node_(std::make_shared<rclcpp::Node>("viewer")),
        group_(node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false)),
        switch_(node_, kOrders, group_) {
    executor_.add_callback_group(group_, node_->get_node_base_interface());
  }

  // Tells, and hears answers if asked to, until something is so.
  bool becomes(const std::function<bool()>& so, bool hears = true) {
    const auto deadline = std::chrono::steady_clock::now() + 120s;
    while (!so() && std::chrono::steady_clock::now() < deadline) {
      if (!switch_.askSorters().empty()) collectEntities(*group_);
      if (hears) executor_.spin_some();
      std::this_thread::sleep_for(10ms);
    }
    return so();
  }

  bool says(const std::string& words) const {
    return switch_.report().text.find(words) != std::string::npos;
  }

  rclcpp::Node::SharedPtr node_;
  rclcpp::CallbackGroup::SharedPtr group_;
  SidecarSwitch switch_;
  rclcpp::executors::SingleThreadedExecutor executor_;
};

}  // namespace

TEST_F(SidecarSwitchTest, tellsWhoIsThereAndWhoComes) {
  switch_.ask("native");
  switch_.askSorters();
  EXPECT_TRUE(switch_.report().failed);
  EXPECT_TRUE(says("no sidecar publishes /switched/order"));
  for (const char* name : {"first", "second"}) {
    Sorter sorter(name);
    EXPECT_TRUE(becomes([&] {
      return sorter.backend() == "native" && says(std::string(name) + " asked for backend native");
    }));
    EXPECT_FALSE(switch_.report().failed);
  }
}

TEST_F(SidecarSwitchTest, tellsAllOfSeveral) {
  std::map<std::string, std::unique_ptr<Sorter>> sorters;
  // All that are there sort with a backend, and have said so, and nobody else.
  const auto all = [&](const std::string& backend) {
    std::size_t told = 0;
    for (auto& [name, sorter] : sorters) {
      told += sorter->backend() == backend && says("/" + name + " asked for backend " + backend);
    }
    const std::string text = switch_.report().text;
    const auto others = static_cast<std::size_t>(std::count(text.begin(), text.end(), ';'));
    return told == sorters.size() && others + 1 == told;
  };
  for (const char* name : {"first", "second"}) sorters[name] = std::make_unique<Sorter>(name);
  switch_.ask("native");
  EXPECT_TRUE(becomes([&] { return all("native"); }));
  sorters.erase("first");  // what the other one answers is heard nevertheless
  EXPECT_TRUE(becomes([&] { return all("native"); }));
  switch_.ask("numpy");
  EXPECT_TRUE(becomes([&] { return all("numpy"); }));
  sorters["third"] = std::make_unique<Sorter>("third");
  EXPECT_TRUE(becomes([&] { return all("numpy"); }));
  sorters.erase("third");
  EXPECT_TRUE(becomes([&] { return all("numpy"); }));
  switch_.ask("native");
  EXPECT_TRUE(becomes([&] { return all("native"); }));
}

TEST_F(SidecarSwitchTest, saysWhyOneRefuses) {
  Sorter sorter("sorter");
  switch_.ask("abacus");
  EXPECT_TRUE(becomes([&] { return sorter.backend() == "auto" && says("unknown backend"); }));
  EXPECT_TRUE(switch_.report().failed);
}

TEST_F(SidecarSwitchTest, saysNothingOfWhatIsNoLongerAskedFor) {
  Sorter sorter("sorter");
  switch_.ask("native");
  EXPECT_TRUE(becomes([&] { return sorter.backend() == "native"; }, false));
  switch_.ask("");
  for (int i = 0; i < 50; ++i) executor_.spin_once(10ms);  // the answer
  EXPECT_EQ(switch_.report().text, "");
}

}  // namespace rosplat
