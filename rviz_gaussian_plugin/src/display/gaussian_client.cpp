#include "gaussian_client.hpp"

#include <algorithm>
#include <chrono>
#include <iterator>
#include <new>
#include <utility>

#include "messages.hpp"
#include "printable.hpp"
#include "rosplat_core/threads/clock.hpp"
#include "rosplat_ros/ros_versions.hpp"

namespace rosplat {

namespace {

using namespace std::chrono_literals;

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

MapQos toMapQos(const rclcpp::QoS& qos) {
  const bool keeps_all = qos.history() == rclcpp::HistoryPolicy::KeepAll;
  return {qos.reliability() == rclcpp::ReliabilityPolicy::Reliable,
          qos.durability() == rclcpp::DurabilityPolicy::TransientLocal,
          keeps_all ? MapQos().depth : qos.depth()};
}

using Message = rosplat_msgs::msg::GaussianArray;

MapPull<std::shared_ptr<const Message>>::Labelled labelled(std::shared_ptr<const Message> message) {
  const Message& m = *message;
  const std::size_t bytes =
      sizeof(m) + m.payload.size() +
      sizeof(float) * (m.slots.size() + m.positions.size() + m.orientations.size() +
                       m.scales.size() + m.opacities.size() + m.sh.size() + m.channels.size());
  return {{m.map_id, m.revision, m.operation == Message::REPLACE, bytes}, std::move(message)};
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

const char* GaussianClient::mapType() {
  return rosidl_generator_traits::name<rosplat_msgs::msg::GaussianArray>();
}

rclcpp::QoS GaussianClient::mapQos() {
  return rclcpp::QoS(rclcpp::KeepLast(1000)).reliable().transient_local();
}

GaussianClient::GaussianClient(const rclcpp::Node::SharedPtr& node, const std::string& topic,
                               const rclcpp::QoS& qos, SplatScene& scene)
    : node_(node), topic_(topic), scene_(scene), wished_(qos) {
  group_ = node_->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive, false);
  const auto overridable = rclcpp::QosOverridingOptions::with_default_policies();
  rclcpp::SubscriptionOptions options;
  options.callback_group = group_;
  options.qos_overriding_options = overridable;
  rclcpp::PublisherOptions publishing;
  publishing.qos_overriding_options = overridable;
  remapped_ = node_->get_node_topics_interface()->resolve_topic_name(topic_);
  pull_client_ = PullClient::make(
      *node_, remapped_ + "/pull", group_,
      [this](std::uint64_t number, std::shared_ptr<const PullClient::Response> response) {
        takeAnswer(number, std::move(response));
      });
  subscribe(toMapQos(wished_));
  status_.topic = remapped_;
  orders_ = node_->create_subscription<SplatOrder>(
      remapped_ + "/order", viewQos(8),
      [this](std::unique_ptr<SplatOrder> message) { receive(*message); }, options);
  sidecar_ = std::make_unique<SidecarSwitch>(node_, remapped_ + "/order", group_);
  view_publisher_ = node_->create_publisher<rosplat_msgs::msg::ViewCamera>(remapped_ + "/view",
                                                                           viewQos(32), publishing);
  picked_publisher_ = node_->create_publisher<rosplat_msgs::msg::Gaussian>(remapped_ + "/picked",
                                                                           pickedQos(), publishing);
  pull_tick_ = node_->create_wall_timer(100ms, [this] { tick(); }, group_);
  executor_.add_callback_group(group_, node_->get_node_base_interface());
  start();
  watch();
}

GaussianClient::~GaussianClient() { stop(); }

void GaussianClient::start() {
  stop_ = false;
  thread_ = std::thread([this] {
    while (!stop_ && rclcpp::ok()) {
      try {
        executor_.spin_once(100ms);
      } catch (const std::exception& error) {  // memory may be lacking for a message, say
        RCLCPP_ERROR_THROTTLE(node_->get_logger(), steady_clock_, 5000, "%s: %s", topic_.c_str(),
                              printable(error.what()).c_str());
      }
    }
  });
}

void GaussianClient::stop() {
  stop_ = true;
  executor_.cancel();
  thread_.join();
}

void GaussianClient::subscribe(const MapQos& asked) {
  rclcpp::QoS qos(wished_);
  if (asked.depth != toMapQos(wished_).depth) qos.keep_last(asked.depth);
  if (!asked.reliable) qos.best_effort();
  if (!asked.transient_local) qos.durability_volatile();
  rclcpp::SubscriptionOptions options;
  options.callback_group = group_;
  qos_ = asked;
  pull_.subscribedAnew(now());
  map_ = node_->create_subscription<GaussianArray>(
      topic_, qos,
      [this](std::shared_ptr<const GaussianArray> message) { hear(std::move(message)); }, options);
}

void GaussianClient::hear(std::shared_ptr<const GaussianArray> message) {
  note(message->map_id);
  pull_.held = isFull();
  // A REPLACE is taken in any case: it drops all that waits.
  if (pull_.held && served() && message->operation != GaussianArray::REPLACE) {
    return pull_.miss(labelled(std::move(message)).label, now());
  }
  act(pull_.hear(labelled(std::move(message)), now(), served()));
}

void GaussianClient::tick() {
  pull_.held = isFull();
  act(pull_.tick(now(), served()));
}

bool GaussianClient::isFull() const { return scene_.backlog().bytes > kMostBacklog; }

void GaussianClient::note(const std::string& map_id) {
  if (map_id == maps_[0]) return;
  const std::lock_guard lock(mutex_);
  status_.contended |= map_id == maps_[1];
  maps_ = {map_id, maps_[0]};
}

void GaussianClient::act(Pull::Step step) {
  if (step.request) send(*step.request);  // first, so that it is answered meanwhile
  if (step.subscribe_anew) subscribe_anew_ = true;
  for (const auto& [message, arrival] : step.batches) {
    if (!take(*message, arrival)) return pull_.lose(now());
  }
}

void GaussianClient::send(const Pull::Request& request) {
  auto asked = std::make_shared<PullClient::Request>();
  asked->map_id = request.map_id;
  asked->after_revision = request.after_revision;
  asked->first_block = request.first_block;
  pull_client_->ask(std::move(asked), request.number,
                    [this](std::uint64_t number) { return pull_.awaits(number); });
}

void GaussianClient::takeAnswer(std::uint64_t number,
                                std::shared_ptr<const PullClient::Response> response) {
  std::vector<Pull::Labelled> batches;
  for (const GaussianArray& batch : response->batches) {
    batches.push_back(labelled(std::shared_ptr<const GaussianArray>(response, &batch)));
  }
  pull_.held = isFull();
  act(pull_.answer(number, std::move(batches), response->next_block, now(), served()));
}

bool GaussianClient::take(const GaussianArray& message, Arrival arrival) {
  try {
    GaussianBatch batch = toBatch(message);
    batch.arrival = arrival;
    scene_.apply(batch);
    const std::lock_guard lock(mutex_);
    ++status_.batches;
    status_.frame_id = message.header.frame_id;
    status_.refusal.clear();
  } catch (const BatchError& error) {
    refuse(error.what());
  } catch (const std::bad_alloc&) {
    refuse("memory is lacking");
    return false;
  }
  return true;
}

void GaussianClient::refuse(const std::string& why) {
  RCLCPP_ERROR_THROTTLE(node_->get_logger(), steady_clock_, 5000, "%s: a batch is refused: %s",
                        topic_.c_str(), printable(why).c_str());
  const std::lock_guard lock(mutex_);
  ++status_.refused;
  status_.refusal = why;
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
    status_.dropped_order.clear();
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
  status_.dropped_order = why;
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
  status_.dropped_order.clear();
}

void GaussianClient::watch() {
  if (now() - watched_ < kWatchPeriod) return;
  if (!node_->get_node_base_interface()->get_context()->is_valid()) return;  // ROS has ended
  watched_ = now();
  try {
    sidecar_->tell();
    watchPublishers();
  } catch (const std::exception& error) {
    if (!node_->get_node_base_interface()->get_context()->is_valid()) return;  // ROS has ended
    RCLCPP_ERROR_THROTTLE(node_->get_logger(), steady_clock_, 5000, "%s: %s", topic_.c_str(),
                          printable(error.what()).c_str());
  }
}

void GaussianClient::watchPublishers() {
  const std::size_t sorters = node_->count_publishers(remapped_ + "/order");
  views_followed_ = view_publisher_->get_subscription_count() > sorters;
  std::string other_type;
  std::vector<std::string> names;
  std::vector<MapQos> offers;
  for (const auto& publisher : node_->get_publishers_info_by_topic(topic_)) {
    names.push_back(publisher.node_name());
    if (publisher.topic_type() == mapType()) {
      offers.push_back(toMapQos(publisher.qos_profile()));
    } else {
      other_type = publisher.topic_type();
    }
  }
  serves_ = served() || (serves_ && !offers.empty());
  const MapQosChoice chosen = chooseMapQos(toMapQos(wished_), offers, serves_);
  const bool anew = subscribe_anew_.exchange(false) && chosen.qos.transient_local;
  if (anew || !(chosen.qos == qos_)) {
    const Pause pause(*this);
    subscribe(chosen.qos);
  }
  const std::lock_guard lock(mutex_);
  if (sorters == 0) status_.dropped_order.clear();
  status_.publishers = std::move(names);
  if (status_.publishers.size() < 2) status_.contended = false;
  status_.other_type = other_type;
  status_.unheard.clear();
  const bool any_volatile = std::any_of(offers.begin(), offers.end(),
                                        [](const MapQos& offer) { return !offer.transient_local; });
  if (chosen.best_effort_unheard) {
    status_.unheard = "best effort and another is reliable: set Reliability Policy to Best Effort";
  } else if (chosen.volatile_unheard) {
    status_.unheard = "volatile and another is transient local: set Durability Policy to Volatile";
  } else if (any_volatile && !serves_) {
    status_.unheard = "volatile: what it sent before is lost";
  }
}

void GaussianClient::publishPose(const rosplat_msgs::msg::ViewCamera& view) {
  if (!trail_) trail_ = std::make_unique<CameraTrail>(*node_, remapped_ + "/camera");
  geometry_msgs::msg::PoseStamped pose;
  pose.header = view.header;
  pose.pose = view.pose;
  trail_->publish(pose);
}

void GaussianClient::setServing(bool serving) {
  if (!serving) return render_service_.reset();
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
  Status status = status_;
  status.sidecar = sidecar_->report();
  return status;
}

std::string GaussianClient::frameId() const {
  const std::lock_guard lock(mutex_);
  return status_.frame_id;
}

std_msgs::msg::Header GaussianClient::header() const {
  std_msgs::msg::Header header;
  header.frame_id = frameId();
  header.stamp = node_->now();
  return header;
}

}  // namespace rosplat
