#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/srv/pull_map.hpp>
#include <string>
#include <utility>

namespace rosplat {

// Asks the servers of a map for its missing parts, and hears the answer of each server. (rclcpp's
// own client takes only the first answer to a request.) Only the group's thread asks and hears.
class PullClient : public rclcpp::Client<rosplat_msgs::srv::PullMap> {
 public:
  using Hear = std::function<void(std::shared_ptr<const Response>)>;

  PullClient(rclcpp::Node& node, const std::string& service, rcl_client_options_t options)
      : Client(node.get_node_base_interface().get(), node.get_node_graph_interface(), service,
               options) {}

  static std::shared_ptr<PullClient> make(rclcpp::Node& node, const std::string& service,
                                          rclcpp::CallbackGroup::SharedPtr group) {
    auto client = std::make_shared<PullClient>(node, service, rcl_client_get_default_options());
    node.get_node_services_interface()->add_client(client, std::move(group));
    return client;
  }

  // Answers to earlier requests aren't heard any more.
  void ask(Request::SharedPtr request, Hear hear) {
    if (asked_) remove_pending_request(*asked_);
    hear_ = std::move(hear);
    asked_ = async_send_request(std::move(request)).request_id;
  }

  void handle_response(std::shared_ptr<rmw_request_id_t> request,
                       std::shared_ptr<void> response) override {
    if (request->sequence_number != asked_) return;
    const Hear hear = hear_;  // a copy: the call may ask again
    hear(std::static_pointer_cast<const Response>(response));
  }

 private:
  std::optional<std::int64_t> asked_;
  Hear hear_;
};

}  // namespace rosplat
