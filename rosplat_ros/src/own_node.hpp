#pragma once

#include <rclcpp/rclcpp.hpp>
#include <string>

#include "rosplat_ros/group_thread.hpp"
#include "rosplat_ros/node_interfaces.hpp"

namespace rosplat {

// A node in a participant of its own, which joins the network beside another node.
struct OwnNode {
  explicit OwnNode(const NodeInterfaces& beside)
      : context(joined(*beside.base->get_context())),
        node(beside.base->get_name() + std::string("_anew"), beside.base->get_namespace(),
             rclcpp::NodeOptions()
                 .context(context)
                 .use_global_arguments(false)
                 .start_parameter_services(false)
                 .start_parameter_event_publisher(false)),
        group(node.create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false)),
        thread(NodeInterfaces(node), group) {}
  ~OwnNode() {
    thread.stop();
    context->shutdown("its owner ends");
  }
  OwnNode(const OwnNode&) = delete;
  OwnNode& operator=(const OwnNode&) = delete;

  rclcpp::Context::SharedPtr context;
  rclcpp::Node node;
  rclcpp::CallbackGroup::SharedPtr group;
  GroupThread thread;  // of the group

 private:
  static rclcpp::Context::SharedPtr joined(rclcpp::Context& beside) {
    rclcpp::InitOptions options;
    options.set_domain_id(beside.get_domain_id());
    options.auto_initialize_logging(false);
    options.shutdown_on_signal = false;  // the owner may still need it then
    auto context = std::make_shared<rclcpp::Context>();
    context->init(0, nullptr, options);
    return context;
  }
};

}  // namespace rosplat
