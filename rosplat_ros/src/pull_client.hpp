#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/srv/pull_map.hpp>
#include <string>
#include <utility>

namespace rosplat {

// Asks the servers of a map for its missing parts, and hears the answer of each server. (rclcpp's
// own client takes only the first answer to a request.) Only the group's thread asks and hears.
class PullClient : public rclcpp::Client<rosplat_msgs::srv::PullMap> {
 public:
  // Takes the number of a request, and an answer to it.
  using Hear = std::function<void(std::uint64_t, std::shared_ptr<const Response>)>;

  PullClient(rclcpp::node_interfaces::NodeBaseInterface& node,
             rclcpp::node_interfaces::NodeGraphInterface::SharedPtr graph,
             const std::string& service, rcl_client_options_t options, Hear hear)
      : Client(&node, std::move(graph), service, options), hear_(std::move(hear)) {}

  static std::shared_ptr<PullClient> make(
      rclcpp::node_interfaces::NodeBaseInterface& node,
      rclcpp::node_interfaces::NodeGraphInterface::SharedPtr graph,
      rclcpp::node_interfaces::NodeServicesInterface& services, const std::string& service,
      rclcpp::CallbackGroup::SharedPtr group, Hear hear) {
    auto client = std::make_shared<PullClient>(node, std::move(graph), service,
                                               rcl_client_get_default_options(), std::move(hear));
    services.add_client(client, std::move(group));
    return client;
  }

  // Answers to earlier requests are heard only while they are awaited, told by the number.
  void ask(Request::SharedPtr request, std::uint64_t number,
           const std::function<bool(std::uint64_t)>& awaited) {
    for (auto asked = asked_.begin(); asked != asked_.end();) {
      const bool outdated = !awaited(asked->second);
      if (outdated) remove_pending_request(asked->first);
      asked = outdated ? asked_.erase(asked) : std::next(asked);
    }
    asked_[async_send_request(std::move(request)).request_id] = number;
  }

  void handle_response(std::shared_ptr<rmw_request_id_t> request,
                       std::shared_ptr<void> response) override {
    const auto asked = asked_.find(request->sequence_number);
    if (asked == asked_.end()) return;
    hear_(asked->second, std::static_pointer_cast<const Response>(response));
  }

 private:
  const Hear hear_;
  std::map<std::int64_t, std::uint64_t> asked_;  // numbers of requests, by ROS's numbers
};

}  // namespace rosplat
