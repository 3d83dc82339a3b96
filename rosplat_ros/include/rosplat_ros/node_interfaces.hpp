#pragma once

#include <rclcpp/node_interfaces/node_base_interface.hpp>
#include <rclcpp/node_interfaces/node_clock_interface.hpp>
#include <rclcpp/node_interfaces/node_graph_interface.hpp>
#include <rclcpp/node_interfaces/node_logging_interface.hpp>
#include <rclcpp/node_interfaces/node_parameters_interface.hpp>
#include <rclcpp/node_interfaces/node_services_interface.hpp>
#include <rclcpp/node_interfaces/node_timers_interface.hpp>
#include <rclcpp/node_interfaces/node_topics_interface.hpp>

namespace rosplat {

// What maps are sent and heard by, of an rclcpp::Node, a LifecycleNode, or any that has the same.
struct NodeInterfaces {
  template <typename Node>
  explicit NodeInterfaces(Node& node)
      : base(node.get_node_base_interface()),
        topics(node.get_node_topics_interface()),
        parameters(node.get_node_parameters_interface()),
        services(node.get_node_services_interface()),
        graph(node.get_node_graph_interface()),
        timers(node.get_node_timers_interface()),
        clock(node.get_node_clock_interface()),
        logging(node.get_node_logging_interface()) {}

  rclcpp::node_interfaces::NodeBaseInterface::SharedPtr base;
  rclcpp::node_interfaces::NodeTopicsInterface::SharedPtr topics;
  rclcpp::node_interfaces::NodeParametersInterface::SharedPtr parameters;
  rclcpp::node_interfaces::NodeServicesInterface::SharedPtr services;
  rclcpp::node_interfaces::NodeGraphInterface::SharedPtr graph;
  rclcpp::node_interfaces::NodeTimersInterface::SharedPtr timers;
  rclcpp::node_interfaces::NodeClockInterface::SharedPtr clock;
  rclcpp::node_interfaces::NodeLoggingInterface::SharedPtr logging;
};

}  // namespace rosplat
