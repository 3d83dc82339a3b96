#include "gaussian_client.hpp"

#include <iterator>
#include <new>
#include <utility>

#include "messages.hpp"
#include "ros_graph.hpp"
#include "rosplat_core/map/printable.hpp"
#include "rosplat_core/threads/clock.hpp"
#include "rosplat_ros/batches.hpp"

namespace rosplat {

namespace {

constexpr double kWatchPeriod = 1;  // [s]
// While more edits wait to be drawn, batches that can be pulled later aren't taken. [bytes]
constexpr std::size_t kMostBacklog = std::size_t{1} << 26;

// As in rosplat_sorter's qos.py, which says why.
rclcpp::QoS viewQos(std::size_t depth) {
  return rclcpp::QoS(rclcpp::KeepLast(depth)).reliable().durability_volatile();
}
// As deep as the most splats that one selection publishes, MapSelection::kListed.
rclcpp::QoS pickedQos() {
  return rclcpp::QoS(rclcpp::KeepLast(100)).reliable().durability_volatile();
}

// The client that sent a request.
std::string clientOf(const rmw_request_id_t& id) {
  return {std::begin(id.writer_guid), std::end(id.writer_guid)};
}

}  // namespace

void GaussianClient::RenderRequest::answer(RenderView::Response& response) const {
  try {
    service->send_response(*id, response);
  } catch (const std::exception& error) {  // a picture too large for the middleware, say
    RCLCPP_ERROR(rclcpp::get_logger("rosplat"), "a picture isn't sent: %s",
                 printable(error.what()).c_str());
  }
}

void GaussianClient::RenderRequest::refuse(const std::string& why) const {
  RenderView::Response response;
  response.message = why;
  answer(response);
}

GaussianClient::GaussianClient(const rclcpp::Node::SharedPtr& node, const std::string& topic,
                               const rclcpp::QoS& qos, SplatScene& scene)
    : node_(node), topic_(topic), scene_(scene) {
  group_ = node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false);
  const auto overridable = rclcpp::QosOverridingOptions::with_default_policies();
  rclcpp::SubscriptionOptions options;
  options.callback_group = group_;
  options.qos_overriding_options = overridable;
  rclcpp::PublisherOptions publishing;
  publishing.qos_overriding_options = overridable;
  remapped_ = node_->get_node_topics_interface()->resolve_topic_name(topic_);
  ReceiverOptions receiving;
  receiving.topic = topic_;
  receiving.qos = qos;
  receiving.busy = [this] { return scene_.backlog().bytes > kMostBacklog; };
  receiving.group = group_;
  receiving.watches = false;
  map_ = std::make_unique<MapReceiver>(
      *node_,
      [this](const MapReceiver::GaussianArray& batch, Arrival arrival) { apply(batch, arrival); },
      receiving);
  orders_ = node_->create_subscription<SplatOrder>(
      remapped_ + "/order", viewQos(8),
      [this](std::unique_ptr<SplatOrder> message) { receive(*message); }, options);
  sidecar_ = std::make_unique<SidecarSwitch>(node_, remapped_ + "/order", group_);
  view_publisher_ = node_->create_publisher<rosplat_msgs::msg::ViewCamera>(remapped_ + "/view",
                                                                           viewQos(32), publishing);
  picked_publisher_ = node_->create_publisher<rosplat_msgs::msg::Gaussian>(remapped_ + "/picked",
                                                                           pickedQos(), publishing);
  receiving_ = std::make_unique<GroupThread>(NodeInterfaces(*node_), group_);
  receiving_->start();
  watch();
}

GaussianClient::~GaussianClient() { receiving_->stop(); }

void GaussianClient::apply(const MapReceiver::GaussianArray& message, Arrival arrival) {
  scene_.apply(toBatch(message, arrival));
  const std::lock_guard lock(mutex_);
  frame_id_ = message.header.frame_id;
}

void GaussianClient::receive(SplatOrder& message) {
  {
    const std::lock_guard lock(mutex_);
    if (views_.count(message.view_id) == 0) return;  // another viewer's
  }
  try {
    const auto order = scene_.newOrder();
    toOrder(message, scene_.mostSlots(message.map_id, message.revision), reader_, *order);
    scene_.offer(order);
    if (const std::string remark = reader_.takeRemark(); !remark.empty()) {
      RCLCPP_WARN(node_->get_logger(), "%s/order: %s", topic_.c_str(), remark.c_str());
    }
    const std::lock_guard lock(mutex_);
    dropped_order_.clear();
  } catch (const OrderError& error) {
    dropOrder(error.what());
  } catch (const std::bad_alloc&) {
    dropOrder("memory is lacking");
  }
}

void GaussianClient::dropOrder(const std::string& why) {
  RCLCPP_WARN_THROTTLE(node_->get_logger(), steady_clock_, 5000,
                       "%s/order: an order is dropped: %s", topic_.c_str(), printable(why).c_str());
  const std::lock_guard lock(mutex_);
  dropped_order_ = why;
}

void GaussianClient::publish(rosplat_msgs::msg::ViewCamera view) {
  {
    const std::lock_guard lock(mutex_);
    views_.insert(view.view_id);
  }
  view.segment_key = reader_.key();
  view_publisher_->publish(view);
}

void GaussianClient::forget(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  views_.erase(view_id);
  dropped_order_.clear();
}

void GaussianClient::watch() {
  if (now() - watched_ < kWatchPeriod) return;
  if (!node_->get_node_base_interface()->get_context()->is_valid()) return;  // ROS has ended
  watched_ = now();
  try {
    if (auto gone = sidecar_->askSorters(); !gone.empty()) {
      const Pause pause(*receiving_);
      gone.clear();
    }
    watchPublishers();
  } catch (const std::exception& error) {
    if (!node_->get_node_base_interface()->get_context()->is_valid()) return;  // ROS has ended
    RCLCPP_ERROR_THROTTLE(node_->get_logger(), steady_clock_, 5000, "%s: %s", topic_.c_str(),
                          printable(error.what()).c_str());
  }
}

void GaussianClient::watchPublishers() {
  sorters_ = node_->count_publishers(remapped_ + "/order");
  views_followed_ = view_publisher_->get_subscription_count() > sorters_;
  if (map_->report().batches == 0) other_user_ = otherUserSharesMemory();
  if (map_->watch()) {
    const Pause pause(*receiving_);
    map_->subscribe();
  }
  const std::lock_guard lock(mutex_);
  if (sorters_ == 0) dropped_order_.clear();
}

void GaussianClient::publishPose(const rosplat_msgs::msg::ViewCamera& view) {
  if (!trail_) trail_ = std::make_unique<CameraTrail>(*node_, remapped_ + "/camera");
  geometry_msgs::msg::PoseStamped pose;
  pose.header = view.header;
  pose.pose = view.pose;
  trail_->publish(pose);
}

void GaussianClient::setServing(bool serving) {
  if (!serving) {
    const Pause pause(*receiving_);
    return render_service_.reset();
  }
  render_service_ = node_->create_service<RenderView>(
      remapped_ + "/render",
      [this](std::shared_ptr<rclcpp::Service<RenderView>> service,
             std::shared_ptr<rmw_request_id_t> id, std::shared_ptr<RenderView::Request> request) {
        const std::string client = clientOf(*id);
        RenderRequest asked{std::move(service), std::move(id), std::move(request)};
        const std::lock_guard lock(mutex_);
        if (const auto refused = requests_.push(client, std::move(asked))) {
          refused->refuse("too many pictures are asked for at once");
        }
      },
      serviceQos(), group_);
}

std::optional<GaussianClient::RenderRequest> GaussianClient::takeRenderRequest() {
  const std::lock_guard lock(mutex_);
  return requests_.pop();
}

bool GaussianClient::renderRequestsWait() const {
  const std::lock_guard lock(mutex_);
  return !requests_.empty();
}

GaussianClient::Status GaussianClient::status() const {
  const std::lock_guard lock(mutex_);
  Status status{map_->report(), frame_id_,         {}, other_user_, sorters_,
                dropped_order_, sidecar_->report()};
  if (status.best_effort_unheard) {
    status.unheard = "best effort and another is reliable: set Reliability Policy to Best Effort";
  } else if (status.volatile_unheard) {
    status.unheard = "volatile and another is transient local: set Durability Policy to Volatile";
  } else if (status.begun_without) {
    status.unheard = "volatile: what it sent before is lost";
  }
  return status;
}

std::string GaussianClient::frameId() const {
  const std::lock_guard lock(mutex_);
  return frame_id_;
}

std_msgs::msg::Header GaussianClient::header() const {
  std_msgs::msg::Header header;
  header.frame_id = frameId();
  header.stamp = node_->now();
  return header;
}

}  // namespace rosplat
