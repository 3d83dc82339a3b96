#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/msg/gaussian_array.hpp>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_ros/node_interfaces.hpp"

namespace rosplat {

// What publishers of maps offer: reliable, transient local, as deep as their history.
inline rclcpp::QoS mapQos() {
  return rclcpp::QoS(rclcpp::KeepLast(1000)).reliable().transient_local();
}

struct ReceiverOptions {
  std::string topic = "gaussians";  // pulls are asked for at <topic>/pull
  rclcpp::QoS qos = mapQos();       // the most that the subscription asks for
  // Whether there is no room for batches. Those that can be pulled later are dropped then, but for
  // a REPLACE.
  std::function<bool()> busy = [] { return false; };
  std::uint8_t most_sh_degree = 3;         // pulled batches have no harmonics above this degree
  rclcpp::CallbackGroup::SharedPtr group;  // mutually exclusive; none: one that the node spins
  bool watches = true;  // false: the owner calls watch() and subscribe(), and reads the report
};

// Hears the publishers of a map's topic, and pulls what is missing from their servers.
//
// The subscription asks for what chooseMapQos says of the publishers, and begins anew when that
// changes. MapPull tells batches that come again from a map that is played again, and when nothing
// reaches this process: the receiver then joins the network anew, by a participant of its own, and
// calls back from a thread of its own. Until then all callbacks are of one callback group, which
// the node's executor spins. End a receiver in the thread that spins it, or once nobody does.
class MapReceiver {
 public:
  using GaussianArray = rosplat_msgs::msg::GaussianArray;
  // Applies a batch. May throw BatchError for one that contradicts itself, which is refused, and
  // std::bad_alloc: then the batches after it aren't applied, and all of the map is pulled again
  // after a while.
  using OnBatch = std::function<void(const GaussianArray& batch, Arrival arrival)>;

  static const char* mapType() { return rosidl_generator_traits::name<GaussianArray>(); }

  // What has arrived, and from whom.
  struct Report {
    std::string topic;  // as it is remapped
    std::uint64_t batches = 0;
    std::uint64_t refused = 0;            // batches that contradict themselves
    std::string refusal;                  // of the last batch; empty if it was taken
    bool pulling = false;                 // a part of the map is missing and being pulled
    std::vector<std::string> publishers;  // nodes that publish on the topic
    bool contended = false;               // a map came back after another had replaced it
    std::string other_type;               // type that a publisher has instead of mapType()
    bool best_effort_unheard = false;     // a publisher, beside a reliable one
    bool volatile_unheard = false;        // a publisher, beside a transient local one
    bool begun_without = false;           // a publisher's batches before the subscription are lost
    bool joined_anew = false;             // nothing had reached the node's own participant
  };

  // Subscribes. node: as for MapPublisher. Throws rclcpp's exceptions for a topic with an invalid
  // name.
  template <typename Node>
  MapReceiver(Node& node, OnBatch on_batch, const ReceiverOptions& options = {})
      : MapReceiver(NodeInterfaces(node), std::move(on_batch), options) {}
  ~MapReceiver();

  Report report() const;  // for any thread

  // Looks at the topic's publishers; to be called once a second or so. Returns whether it is time
  // to subscribe() anew.
  bool watch();
  // Subscribes anew, while nobody spins the group: see GroupThread::Pause.
  void subscribe();

 private:
  class Listener;
  MapReceiver(const NodeInterfaces& node, OnBatch on_batch, const ReceiverOptions& options);

  std::unique_ptr<Listener> listener_;
};

}  // namespace rosplat
