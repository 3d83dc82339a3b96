#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/srv/pull_map.hpp>
#include <set>
#include <string>

#include "../src/pull_client.hpp"

namespace rosplat {

namespace {

using namespace std::chrono_literals;
using rosplat_msgs::srv::PullMap;

// One of several that serve pulls of the same map.
class Server {
 public:
  explicit Server(const std::string& name)
      : node_(std::make_shared<rclcpp::Node>(name)),
        service_(node_->create_service<PullMap>(
            "/pulled",
            [name](const PullMap::Request::SharedPtr, const PullMap::Response::SharedPtr response) {
              response->batches.resize(1);
              response->batches.front().map_id = " of " + name;
            })) {
    executor_.add_node(node_);
  }
  void answer() { executor_.spin_some(); }

 private:
  rclcpp::Node::SharedPtr node_;
  rclcpp::Service<PullMap>::SharedPtr service_;
  rclcpp::executors::SingleThreadedExecutor executor_;
};

class PullClientTest : public testing::Test {
 protected:
  static void SetUpTestSuite() { rclcpp::init(0, nullptr); }
  static void TearDownTestSuite() { rclcpp::shutdown(); }

  PullClientTest()
      : node_(std::make_shared<rclcpp::Node>("receiver")),
        group_(node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false)),
        client_(PullClient::make(
            *node_->get_node_base_interface(), node_->get_node_graph_interface(),
            *node_->get_node_services_interface(), "/pulled", group_,
            [this](std::uint64_t number, std::shared_ptr<const PullMap::Response> response) {
              heard_.insert(std::to_string(number) + response->batches.front().map_id);
            })) {
    executor_.add_callback_group(group_, node_->get_node_base_interface());
  }

  // Whether everybody is heard before patience ends. All listen, or all but the second server.
  bool hears(const std::set<std::string>& all, std::chrono::milliseconds patience,
             bool second_listens = true) {
    const auto deadline = std::chrono::steady_clock::now() + patience;
    while (heard_ != all && std::chrono::steady_clock::now() < deadline) {
      first_.answer();
      if (second_listens) second_.answer();
      executor_.spin_once(5ms);
    }
    return heard_ == all;
  }

  // awaited: the first number whose answers still count.
  void ask(std::uint64_t number, std::uint64_t awaited) {
    heard_.clear();
    client_->ask(std::make_shared<PullMap::Request>(), number,
                 [awaited](std::uint64_t asked) { return asked >= awaited; });
  }

  Server first_{"first"}, second_{"second"};
  rclcpp::Node::SharedPtr node_;
  rclcpp::CallbackGroup::SharedPtr group_;
  std::shared_ptr<PullClient> client_;
  rclcpp::executors::SingleThreadedExecutor executor_;
  std::set<std::string> heard_;
};

}  // namespace

TEST_F(PullClientTest, EachServerIsHeardButOnlyOfAwaitedRequests) {
  bool met = false;
  for (int i = 0; i < 100 && !met; ++i) {
    ask(0, 1);
    met = hears({"0 of first", "0 of second"}, 200ms);
  }
  ASSERT_TRUE(met);
  ask(1, 1);
  ASSERT_TRUE(hears({"1 of first"}, 10s, false));
  ask(2, 2);
  ASSERT_TRUE(hears({"2 of first", "2 of second"}, 10s));  // and not "1 of second"
  ask(3, 3);
  ASSERT_TRUE(hears({"3 of first"}, 10s, false));
  ask(4, 3);
  ASSERT_TRUE(hears({"3 of second", "4 of first", "4 of second"}, 10s));
}

}  // namespace rosplat
