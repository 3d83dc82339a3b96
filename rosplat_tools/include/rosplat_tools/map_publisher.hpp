#pragma once

#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <string>

#include "rosplat_tools/published_map.hpp"

namespace rosplat {

// Publishes a map of Gaussians and its edits: what a SLAM back end links to be seen in rviz.
//
// Owns the topic of one map and its services, which a thread of its own answers, whether the node
// is spun or not. Who just listens to the topic, a bag say, hears the whole map from repeat() or
// the service <topic>/repeat.
class MapPublisher : public PublishedMap {
 public:
  // Advertises the topic and its services; the map is empty, and nothing is sent yet. Throws
  // std::invalid_argument for an option that is none.
  //
  // node: an rclcpp::Node, an rclcpp_lifecycle::LifecycleNode, whose state doesn't matter, or
  // whatever else has their interfaces.
  template <typename Node>
  explicit MapPublisher(Node& node, const MapOptions& options = {})
      : MapPublisher(Interfaces{node.get_node_base_interface(), node.get_node_topics_interface(),
                                node.get_node_parameters_interface(),
                                node.get_node_services_interface(), node.get_node_graph_interface(),
                                node.get_node_clock_interface(), node.get_node_logging_interface()},
                     options) {}
  ~MapPublisher();

 private:
  class Services;
  struct Interfaces {
    rclcpp::node_interfaces::NodeBaseInterface::SharedPtr base;
    rclcpp::node_interfaces::NodeTopicsInterface::SharedPtr topics;
    rclcpp::node_interfaces::NodeParametersInterface::SharedPtr parameters;
    rclcpp::node_interfaces::NodeServicesInterface::SharedPtr services;
    rclcpp::node_interfaces::NodeGraphInterface::SharedPtr graph;
    rclcpp::node_interfaces::NodeClockInterface::SharedPtr clock;
    rclcpp::node_interfaces::NodeLoggingInterface::SharedPtr logging;
  };

  MapPublisher(const Interfaces& node, const MapOptions& options);
  static Wire wireOf(Interfaces node, const std::string& topic);

  std::unique_ptr<Services> services_;
};

}  // namespace rosplat
