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
#include "rosplat_ros/node_interfaces.hpp"

namespace rosplat {

struct MapOptions {
  std::string frame_id = "map";
  std::string topic = "gaussians";      // its services are <topic>/pull and <topic>/repeat
  std::size_t chunk_bytes = 8'000'000;  // the most bytes of a message's arrays
  std::string compression = "none";     // or "quantised", for subscribers across a network
};

// Publishes a map of Gaussians and its edits. A SLAM back end links this to show its map in rviz2.
//
// A MapPublisher owns the topic of one map and its services. A thread of its own answers the
// services, so the node needn't be spun. For listeners that can't pull, such as a recorder,
// repeat() or the service <topic>/repeat sends the whole map again.
class MapPublisher : public PublishedMap {
 public:
  // Advertises the topic and its services. The map is empty, and nothing is sent yet. Throws
  // std::invalid_argument for an option that isn't allowed.
  //
  // node: an rclcpp::Node, an rclcpp_lifecycle::LifecycleNode in any state, or another type with
  // the same interfaces.
  template <typename Node>
  explicit MapPublisher(Node& node, const MapOptions& options = {})
      : MapPublisher(NodeInterfaces(node), options, std::make_shared<std::atomic<bool>>(false)) {}
  ~MapPublisher();

  // Places groups in the map's frame. A group that was never placed is at the identity.
  void move(const std::map<std::uint32_t, geometry_msgs::msg::Pose>& poses,
            const When& stamp = std::nullopt);

 private:
  class Services;
  MapPublisher(const NodeInterfaces& node, const MapOptions& options,
               const std::shared_ptr<std::atomic<bool>>& closing);
  static Wire wireOf(NodeInterfaces node, const MapOptions& options,
                     const std::shared_ptr<std::atomic<bool>>& closing);

  const std::shared_ptr<std::atomic<bool>> closing_;  // true: repeat() waits no longer
  std::unique_ptr<Services> services_;
};

}  // namespace rosplat
