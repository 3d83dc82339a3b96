#include "rosplat_ros/map_publisher.hpp"

#include <chrono>
#include <future>
#include <rosplat_msgs/msg/gaussian_array.hpp>
#include <rosplat_msgs/srv/pull_map.hpp>
#include <rosplat_msgs/srv/repeat_map.hpp>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>

#include "rosplat_ros/ros_versions.hpp"

namespace rosplat {

namespace {

using Message = rosplat_msgs::msg::GaussianArray;
using PullMap = rosplat_msgs::srv::PullMap;
using RepeatMap = rosplat_msgs::srv::RepeatMap;
using Clock = std::chrono::steady_clock;

constexpr int kWarningPeriod = 5000;  // [ms]
// How long repeat() waits for a subscriber that acknowledges nothing: by then the middleware has
// given up a subscriber that is gone. Every kLook, repeat() checks whether it should wait on.
constexpr std::chrono::seconds kPatience(30);
constexpr std::chrono::milliseconds kLook(100);

// Of warnings: simulated time may stand still.
rclcpp::Clock::SharedPtr steadyClock() { return std::make_shared<rclcpp::Clock>(RCL_STEADY_TIME); }

geometry_msgs::msg::Pose messageOf(const Pose& pose) {
  geometry_msgs::msg::Pose message;
  auto& p = message.position;
  auto& q = message.orientation;
  std::tie(p.x, p.y, p.z) = std::tuple_cat(pose.position);
  std::tie(q.x, q.y, q.z, q.w) = std::tuple_cat(pose.orientation);
  return message;
}

// Copies only where a message's array is of another type, as Lyrical's uint8[] is.
template <typename To, typename From>
void assign(To& to, From&& from) {
  if constexpr (std::is_assignable_v<To&, From&&>) {
    to = std::forward<From>(from);
  } else {
    to.assign(from.begin(), from.end());
  }
}

Message messageOf(PublishedMap::Batch&& batch, const std::string& frame_id, rclcpp::Clock& clock) {
  const Stamp stamp = batch.stamp ? *batch.stamp : Stamp(clock.now());
  Message message;
  message.header.frame_id = frame_id;
  message.header.stamp.sec = stamp.sec;
  message.header.stamp.nanosec = stamp.nanosec;
#define WRITE(field) assign(message.field, std::move(batch.field));
  ROSPLAT_BATCH_FIELDS(WRITE)
#undef WRITE
  std::tie(message.origin.x, message.origin.y, message.origin.z) = std::tuple_cat(batch.origin);
  for (const auto& [group, pose] : batch.poses) {
    message.groups.push_back(group);
    message.poses.push_back(messageOf(pose));
  }
  return message;
}

// Serves a callback group in a thread of its own, whether the node is spun or not.
class ServiceThread {
 public:
  explicit ServiceThread(const rclcpp::node_interfaces::NodeBaseInterface::SharedPtr& node)
      : group_(node->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false)),
        executor_(optionsOf(*node)) {
    executor_.add_callback_group(group_, node);
    thread_ = std::thread(
        [this, ended = end_.get_future()] { executor_.spin_until_future_complete(ended); });
  }
  ServiceThread(const ServiceThread&) = delete;
  ServiceThread& operator=(const ServiceThread&) = delete;
  ~ServiceThread() {
    end_.set_value();
    executor_.cancel();
    thread_.join();
  }

  const rclcpp::CallbackGroup::SharedPtr& group() const { return group_; }

 private:
  static rclcpp::ExecutorOptions optionsOf(rclcpp::node_interfaces::NodeBaseInterface& node) {
    rclcpp::ExecutorOptions options;
    options.context = node.get_context();
    return options;
  }

  const rclcpp::CallbackGroup::SharedPtr group_;
  rclcpp::executors::SingleThreadedExecutor executor_;
  std::promise<void> end_;
  std::thread thread_;
};

}  // namespace

PublishedMap::Wire MapPublisher::wireOf(NodeInterfaces node, const MapOptions& options,
                                        const std::shared_ptr<std::atomic<bool>>& closing) {
  // From the last batch a late joiner learns of the map. The others are for subscribers that lag.
  const auto qos = rclcpp::QoS(8).reliable().transient_local();
  rclcpp::PublisherOptions overridable;
  overridable.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
  // Before Jazzy, communication within the process refuses transient local durability.
  overridable.use_intra_process_comm = rclcpp::IntraProcessSetting::Disable;
  const auto publisher = rclcpp::create_publisher<Message>(node.parameters, node.topics,
                                                           options.topic, qos, overridable);
  const rclcpp::Logger logger = node.logging->get_logger();
  const rclcpp::Clock::SharedPtr clock = node.clock->get_clock();
  Wire wire;
  wire.send = [publisher, clock, frame_id = options.frame_id](Batch&& batch) {
    publisher->publish(std::make_unique<Message>(messageOf(std::move(batch), frame_id, *clock)));
  };
  wire.warn = [publisher, logger, steady = steadyClock()](const std::string& text) {
    RCLCPP_WARN_THROTTLE(logger, *steady, kWarningPeriod, "%s: %s", publisher->get_topic_name(),
                         text.c_str());
  };
  wire.settle = [publisher, closing, context = node.base->get_context()] {
    const auto until = Clock::now() + kPatience;
    try {
      while (!publisher->wait_for_all_acked(kLook) && Clock::now() < until && !*closing) {
      }
    } catch (const rclcpp::exceptions::RCLError&) {
      if (context->is_valid()) throw;  // else ROS has ended, and nobody is waited for
    }
  };
  return wire;
}

class MapPublisher::Services {
 public:
  Services(const NodeInterfaces& node, const MapOptions& options, PublishedMap& map)
      : pulling_(node.base), repeating_(node.base) {
    const rclcpp::Logger logger = node.logging->get_logger();
    const std::string name = node.topics->resolve_topic_name(options.topic);
    pull_ = rclcpp::create_service<PullMap>(
        node.base, node.services, name + "/pull",
        [&map, logger, name, frame_id = options.frame_id, graph = node.graph,
         clock = node.clock->get_clock(),
         steady = steadyClock()](const PullMap::Request::SharedPtr request,
                                 const PullMap::Response::SharedPtr response) {
          const bool of_another = !request->map_id.empty() && request->map_id != map.mapId();
          try {
            if (of_another && graph->count_publishers(name) > 1) {
              RCLCPP_WARN_THROTTLE(logger, *steady, kWarningPeriod,
                                   "%s: is published by others, too, and receivers see one map in "
                                   "place of the other: end all publishers but one",
                                   name.c_str());
            }
            Answer answer = map.pull(request->map_id, request->after_revision, request->first_block,
                                     request->most_sh_degree);
            for (Batch& batch : answer.batches) {
              response->batches.push_back(messageOf(std::move(batch), frame_id, *clock));
            }
            response->next_block = answer.next_block;
          } catch (const std::exception& error) {  // no request may end the node
            RCLCPP_ERROR_THROTTLE(logger, *steady, kWarningPeriod, "%s/pull: %s", name.c_str(),
                                  error.what());
            *response = PullMap::Response();
          }
        },
        serviceQos(), pulling_.group());
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
        serviceQos(), repeating_.group());
  }

 private:
  rclcpp::Service<PullMap>::SharedPtr pull_;
  rclcpp::Service<RepeatMap>::SharedPtr repeat_;
  ServiceThread pulling_, repeating_;  // a repeat waits for subscribers, which pull meanwhile
};

MapPublisher::MapPublisher(const NodeInterfaces& node, const MapOptions& options,
                           const std::shared_ptr<std::atomic<bool>>& closing)
    : PublishedMap(options.chunk_bytes, options.compression, wireOf(node, options, closing)),
      closing_(closing),
      services_(std::make_unique<Services>(node, options, *this)) {}

MapPublisher::~MapPublisher() { *closing_ = true; }

void MapPublisher::move(const std::map<std::uint32_t, geometry_msgs::msg::Pose>& poses,
                        const When& stamp) {
  Poses placed;
  for (const auto& [group, pose] : poses) {
    const auto& p = pose.position;
    const auto& q = pose.orientation;
    placed[group] = {{p.x, p.y, p.z}, {q.x, q.y, q.z, q.w}};
  }
  PublishedMap::move(placed, stamp);
}

}  // namespace rosplat
