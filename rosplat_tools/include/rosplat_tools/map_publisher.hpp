#pragma once

#include <memory>
#include <rclcpp/rclcpp.hpp>

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
  explicit MapPublisher(rclcpp::Node& node, const MapOptions& options = {});
  ~MapPublisher();

 private:
  class Services;

  std::unique_ptr<Services> services_;
};

}  // namespace rosplat
