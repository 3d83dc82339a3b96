#include "rosplat_tools/map_publisher.hpp"

#include <rclcpp/version.h>

#include <future>
#include <rosplat_msgs/srv/repeat_map.hpp>
#include <string>
#include <thread>

namespace rosplat {

namespace {

using PullMap = PublishedMap::PullMap;
using RepeatMap = rosplat_msgs::srv::RepeatMap;

constexpr int kWarningPeriod = 5000;  // [ms]

#if RCLCPP_VERSION_MAJOR >= 17  // Iron
rclcpp::QoS serviceQos() { return rclcpp::ServicesQoS(); }
#else
rmw_qos_profile_t serviceQos() { return rmw_qos_profile_services_default; }
#endif

}  // namespace

PublishedMap::Wire MapPublisher::wireOf(Interfaces node, const std::string& topic) {
  // A late joiner hears of the map by the last batch. The others are for readers that lag behind.
  const auto qos = rclcpp::QoS(8).reliable().transient_local();
  const auto publisher = rclcpp::create_publisher<Batch>(node.parameters, node.topics, topic, qos);
  const rclcpp::Logger logger = node.logging->get_logger();
  const rclcpp::Clock::SharedPtr clock = node.clock->get_clock();
  Wire wire;
  wire.send = [publisher](std::unique_ptr<Batch> batch) { publisher->publish(std::move(batch)); };
  wire.now = [clock] { return clock->now(); };
  wire.warn = [publisher, logger, clock](const std::string& text) {
    RCLCPP_WARN_THROTTLE(logger, *clock, kWarningPeriod, "%s: %s", publisher->get_topic_name(),
                         text.c_str());
  };
  return wire;
}

class MapPublisher::Services {
 public:
  Services(const Interfaces& node, const std::string& topic, PublishedMap& map)
      : group_(
            node.base->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false)),
        executor_(optionsOf(node)) {
    const rclcpp::Logger logger = node.logging->get_logger();
    const std::string name = node.topics->resolve_topic_name(topic);
    pull_ = rclcpp::create_service<PullMap>(
        node.base, node.services, name + "/pull",
        [&map, logger, name, graph = node.graph, clock = node.clock->get_clock()](
            const PullMap::Request::SharedPtr request,
            const PullMap::Response::SharedPtr response) {
          const bool other = !request->map_id.empty() && request->map_id != map.mapId();
          if (other && graph->count_publishers(name) > 1) {
            RCLCPP_WARN_THROTTLE(logger, *clock, kWarningPeriod,
                                 "%s: is published by others, too, and receivers see one map in "
                                 "place of the other: end all publishers but one",
                                 name.c_str());
          }
          try {
            *response = map.pull(*request);
          } catch (const std::exception& error) {  // no request may end the node
            RCLCPP_ERROR(logger, "%s/pull: %s", name.c_str(), error.what());
          }
        },
        serviceQos(), group_);
    repeat_ = rclcpp::create_service<RepeatMap>(
        node.base, node.services, name + "/repeat",
        [&map](const RepeatMap::Request::SharedPtr, const RepeatMap::Response::SharedPtr response) {
          try {
            map.repeat();
            response->success = true;
            response->splats = map.size();
          } catch (const std::exception& error) {
            response->message = error.what();
          }
        },
        serviceQos(), group_);
    executor_.add_callback_group(group_, node.base);
    thread_ = std::thread(
        [this, ended = end_.get_future()] { executor_.spin_until_future_complete(ended); });
  }
  Services(const Services&) = delete;
  Services& operator=(const Services&) = delete;
  ~Services() {
    end_.set_value();
    executor_.cancel();
    thread_.join();
  }

 private:
  static rclcpp::ExecutorOptions optionsOf(const Interfaces& node) {
    rclcpp::ExecutorOptions options;
    options.context = node.base->get_context();
    return options;
  }

  const rclcpp::CallbackGroup::SharedPtr group_;
  rclcpp::Service<PullMap>::SharedPtr pull_;
  rclcpp::Service<RepeatMap>::SharedPtr repeat_;
  rclcpp::executors::SingleThreadedExecutor executor_;
  std::promise<void> end_;
  std::thread thread_;
};

MapPublisher::MapPublisher(const Interfaces& node, const MapOptions& options)
    : PublishedMap(options, wireOf(node, options.topic)),
      services_(std::make_unique<Services>(node, options.topic, *this)) {}

MapPublisher::~MapPublisher() = default;

}  // namespace rosplat
