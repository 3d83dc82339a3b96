#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <string>
#include <thread>
#include <type_traits>

#include "../src/display/gaussian_client.hpp"

namespace rosplat {

namespace {

using namespace std::chrono_literals;

class GaussianClientTest : public testing::Test {
 protected:
  static void SetUpTestSuite() { rclcpp::init(0, nullptr); }
  static void TearDownTestSuite() { rclcpp::shutdown(); }

  // The services or the clients of the node that somebody holds.
  template <typename Entity>
  int held(const std::string& service) const {
    int count = 0;
    const auto counts = [&](const std::shared_ptr<Entity>& entity) {
      count += std::string(entity->get_service_name()).rfind(service, 0) == 0;
    };
    const auto sees = [&](const auto& entity) {
      if constexpr (std::is_same_v<decltype(entity), const std::shared_ptr<Entity>&>)
        counts(entity);
    };
    node_->for_each_callback_group([&](const rclcpp::CallbackGroup::SharedPtr& group) {
      group->collect_all_ptrs(sees, sees, sees, sees, sees);
    });
    return count;
  }

  bool becomes(const std::function<bool()>& so) {
    const auto deadline = std::chrono::steady_clock::now() + 60s;
    while (!so() && std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(10ms);
      client_.watch();
    }
    return so();
  }

  rclcpp::Node::SharedPtr node_ = std::make_shared<rclcpp::Node>("viewer");
  SplatScene scene_{ShaderSource{}};
  GaussianClient client_{node_, "/map", mapQos(), scene_};
};

}  // namespace

// rcl has no lock for what makes and ends a node's entities, so one thread must do all of it. The
// client's own thread waits for them nearly always, and holds them meanwhile.
TEST_F(GaussianClientTest, endsItsServiceInTheCallersThread) {
  for (int round = 0; round < 5; ++round) {
    client_.setServing(true);
    std::this_thread::sleep_for(50ms);
    EXPECT_EQ(held<rclcpp::ServiceBase>("/map/render"), 1);
    client_.setServing(false);
    EXPECT_EQ(held<rclcpp::ServiceBase>("/map/render"), 0);
  }
}

TEST_F(GaussianClientTest, endsTheClientsOfASorterThatIsGone) {
  auto sorter = std::make_shared<rclcpp::Node>("sorter");
  auto orders = sorter->create_publisher<rosplat_msgs::msg::SplatOrder>("/map/order", 1);
  client_.switchBackend("native");
  EXPECT_TRUE(becomes([&] { return held<rclcpp::ClientBase>("/sorter/") > 0; }));
  orders.reset();
  sorter.reset();
  EXPECT_TRUE(becomes([&] { return client_.status().sidecar.failed; }));  // nobody is there
  EXPECT_EQ(held<rclcpp::ClientBase>("/sorter/"), 0);
}

}  // namespace rosplat
