#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/srv/load_scene.hpp>
#include <string>

#include "../src/display/ros_graph.hpp"
#include "rosplat_ros/ros_versions.hpp"

namespace {

using namespace std::chrono_literals;
using rosplat_msgs::srv::LoadScene;

rclcpp::TopicEndpointInfo endpoint(const char* space, const char* name) {
  rmw_topic_endpoint_info_t info = rmw_get_zero_initialized_topic_endpoint_info();
  info.node_namespace = space;
  info.node_name = name;
  info.topic_type = "";
  return rclcpp::TopicEndpointInfo(info);
}

TEST(NodeOf, NamesANodeInFull) {
  EXPECT_EQ(rosplat::nodeOf(endpoint("/", "slam")), "/slam");
  EXPECT_EQ(rosplat::nodeOf(endpoint("/robot", "slam")), "/robot/slam");
}

TEST(NodeOf, IsEmptyForANodeNotHeardOf) {
  EXPECT_EQ(rosplat::nodeOf(endpoint("", "")), "");
  EXPECT_EQ(rosplat::nodeOf(endpoint("_NODE_NAMESPACE_UNKNOWN_", "_NODE_NAME_UNKNOWN_")), "");
}

TEST(OtherUserSharesMemory, LooksAtFastDdsFilesAlone) {
  const auto folder = std::filesystem::temp_directory_path() / ("shm_" + std::to_string(getpid()));
  std::filesystem::create_directory(folder);
  const auto found = [&](const std::string& middleware = "rmw_fastrtps_cpp") {
    return rosplat::otherUserSharesMemory(folder, middleware);
  };
  const auto own = [&](const char* name, uid_t user) {
    const std::string path = folder / name;
    std::ofstream{path};
    return chown(path.c_str(), user, static_cast<gid_t>(-1)) == 0;
  };
  EXPECT_FALSE(rosplat::otherUserSharesMemory(folder / "missing"));
  EXPECT_TRUE(own("fastrtps_1", geteuid()));
  const bool root = own("lttng", geteuid() + 1);  // only root gives files away
  EXPECT_FALSE(found());
  if (root) {
    EXPECT_TRUE(own("fastrtps_2", geteuid() + 1));
    EXPECT_TRUE(found());
    EXPECT_TRUE(found("rmw_fastrtps_dynamic_cpp"));
    EXPECT_FALSE(found("rmw_cyclonedds_cpp"));  // those files are of other programs
  }
  std::filesystem::remove_all(folder);
}

// A node with a service that answers, and an executor that stays, as rviz2's does.
class Spun : public testing::Test {
 protected:
  using Client = rclcpp::Client<LoadScene>;

  void SetUp() override {
    rclcpp::init(0, nullptr);
    node_ = std::make_shared<rclcpp::Node>("spun");
    service_ = node_->create_service<LoadScene>(
        "load", [](const LoadScene::Request::SharedPtr, LoadScene::Response::SharedPtr) {});
    executor_ = std::make_unique<rclcpp::executors::SingleThreadedExecutor>();
    executor_->add_node(node_);
  }

  void TearDown() override {
    executor_.reset();
    service_.reset();
    node_.reset();
    rclcpp::shutdown();
  }

  Client::SharedPtr client() {
    auto client = node_->create_client<LoadScene>("load");
    client->wait_for_service(10s);
    return client;
  }

  bool isAnswered(const Client::SharedPtr& client) {
    const auto answer = client->async_send_request(std::make_shared<LoadScene::Request>());
    return executor_->spin_until_future_complete(answer, 5s) == rclcpp::FutureReturnCode::SUCCESS;
  }

  rclcpp::Node::SharedPtr node_;
  rclcpp::Service<LoadScene>::SharedPtr service_;
  std::unique_ptr<rclcpp::executors::SingleThreadedExecutor> executor_;
};

TEST_F(Spun, AClientIsServedAfterItsNeighbourIsDestroyed) {
  auto neighbour = client();
  ASSERT_TRUE(isAnswered(neighbour));  // the executor knows it first
  const auto kept = client();
  ASSERT_TRUE(isAnswered(kept));
  neighbour.reset();
  rosplat::collectEntities(*node_->get_node_base_interface()->get_default_callback_group());
  EXPECT_TRUE(isAnswered(kept));
}

}  // namespace
