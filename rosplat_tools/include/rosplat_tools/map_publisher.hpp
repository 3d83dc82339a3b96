#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <geometry_msgs/msg/pose.hpp>
#include <map>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <string>

#include "rosplat_core/map/published_map.hpp"

namespace rosplat {

struct MapOptions {
  std::string frame_id = "map";
  std::string topic = "gaussians";      // its services are <topic>/pull and <topic>/repeat
  std::size_t chunk_bytes = 8'000'000;  // of a message's arrays, at most
  std::string compression = "none";     // or "quantised", for subscribers beyond a network
};

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
                     options, std::make_shared<std::atomic<bool>>(false)) {}
  ~MapPublisher();

  // Places groups in the map's frame. One that was never placed is where the map's frame is.
  void move(const std::map<std::uint32_t, geometry_msgs::msg::Pose>& poses,
            const When& stamp = std::nullopt);

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

  MapPublisher(const Interfaces& node, const MapOptions& options,
               const std::shared_ptr<std::atomic<bool>>& closing);
  static Wire wireOf(Interfaces node, const MapOptions& options,
                     const std::shared_ptr<std::atomic<bool>>& closing);

  const std::shared_ptr<std::atomic<bool>> closing_;  // nobody is waited for any more
  std::unique_ptr<Services> services_;
};

}  // namespace rosplat
