#include "rosplat_ros/map_receiver.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <mutex>
#include <new>
#include <optional>

#include "own_node.hpp"
#include "pull_client.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/map_pull.hpp"
#include "rosplat_core/map/map_qos.hpp"
#include "rosplat_core/map/printable.hpp"
#include "rosplat_core/threads/clock.hpp"

namespace rosplat {

namespace {

using namespace std::chrono_literals;

using Message = rosplat_msgs::msg::GaussianArray;
using Pull = MapPull<std::shared_ptr<const Message>>;

constexpr auto kWatchPeriod = 1s;
constexpr auto kPullPeriod = 100ms;
constexpr int kWarningPeriod = 5000;  // [ms]

MapQos toMapQos(const rclcpp::QoS& qos) {
  const bool keeps_all = qos.history() == rclcpp::HistoryPolicy::KeepAll;
  return {qos.reliability() == rclcpp::ReliabilityPolicy::Reliable,
          qos.durability() == rclcpp::DurabilityPolicy::TransientLocal,
          keeps_all ? MapQos().depth : qos.depth()};
}

Pull::Labelled labelled(std::shared_ptr<const Message> message) {
  const Message& m = *message;
  const std::size_t bytes =
      sizeof(m) + m.payload.size() +
      sizeof(float) * (m.slots.size() + m.positions.size() + m.orientations.size() +
                       m.scales.size() + m.opacities.size() + m.sh.size() + m.channels.size());
  return {{m.map_id, m.revision, m.operation == Message::REPLACE, bytes}, std::move(message)};
}

}  // namespace

// What the group's callbacks use. watch() may come from another thread; subscribe() may if nobody
// spins the group.
class MapReceiver::Listener {
 public:
  Listener(const NodeInterfaces& node, OnBatch on_batch, const ReceiverOptions& options)
      : node_(node),
        on_batch_(std::move(on_batch)),
        options_(options),
        logger_(node.logging->get_logger()),
        chosen_(toMapQos(options.qos)) {
    if (!options_.group) {
      options_.group =
          node_.base->create_callback_group(rclcpp::CallbackGroupType::MutuallyExclusive);
    }
    report_.topic = node_.topics->resolve_topic_name(options_.topic);
    listen();
  }
  ~Listener() {
    if (own_) own_->thread.stop();
  }

  Report report() const {
    const std::lock_guard lock(mutex_);
    return report_;
  }

  bool watch() {
    std::string other_type;
    std::vector<std::string> names;
    std::vector<MapQos> offers;
    for (const auto& publisher : node_.graph->get_publishers_info_by_topic(options_.topic)) {
      names.push_back(publisher.node_name());
      if (publisher.topic_type() == mapType()) {
        offers.push_back(toMapQos(publisher.qos_profile()));
      } else {
        other_type = publisher.topic_type();
      }
    }
    serves_ = served() || (serves_ && !offers.empty());
    const MapQosChoice choice = chooseMapQos(toMapQos(options_.qos), offers, serves_);
    chosen_ = choice.qos;
    const bool any_volatile = std::any_of(
        offers.begin(), offers.end(), [](const MapQos& offer) { return !offer.transient_local; });
    const bool anew = (subscribe_anew_.exchange(false) && chosen_.transient_local) || join_anew_;
    const std::lock_guard lock(mutex_);
    report_.publishers = std::move(names);
    if (report_.publishers.size() < 2) report_.contended = false;
    report_.other_type = std::move(other_type);
    report_.best_effort_unheard = choice.best_effort_unheard;
    report_.volatile_unheard = choice.volatile_unheard;
    report_.begun_without = any_volatile && !serves_;
    return anew || !(chosen_ == qos_);
  }

  void subscribe() {
    if (join_anew_.exchange(false)) return joinAnew();
    std::optional<GroupThread::Pause> pause;
    if (own_ && !options_.watches) pause.emplace(own_->thread);  // else its thread calls this
    makeSubscription();
  }

 private:
  void makeSubscription() {
    rclcpp::QoS qos(options_.qos);
    if (chosen_.depth != toMapQos(qos).depth) qos.keep_last(chosen_.depth);
    if (!chosen_.reliable) qos.best_effort();
    if (!chosen_.transient_local) qos.durability_volatile();
    rclcpp::SubscriptionOptions options;
    options.callback_group = options_.group;
    // Before Jazzy, communication within the process refuses transient local durability.
    options.use_intra_process_comm = rclcpp::IntraProcessSetting::Disable;
    qos_ = chosen_;
    pull_.subscribedAnew(now());
    map_ = rclcpp::create_subscription<Message>(
        node_.parameters, node_.topics, options_.topic, qos,
        [this](std::shared_ptr<const Message> message) { receive(std::move(message)); }, options);
  }

  void listen() {
    pull_client_ = PullClient::make(
        *node_.base, node_.graph, *node_.services, report_.topic + "/pull", options_.group,
        [this](std::uint64_t number, std::shared_ptr<const PullClient::Response> response) {
          takeAnswer(number, std::move(response));
        });
    if (options_.watches) {
      watch();
      watch_ = addTimer(kWatchPeriod, [this] { meetPublishers(); });
    }
    makeSubscription();
    tick_ = addTimer(kPullPeriod, [this] { tick(); });
  }

  // Listens by a participant of its own from now on, in a thread of its own.
  void joinAnew() {
    RCLCPP_WARN(logger_, "%s: a publisher is there, and nothing of it arrives: joining anew",
                report_.topic.c_str());
    watch_.reset();
    tick_.reset();
    map_.reset();
    pull_client_.reset();
    collectEntities(*options_.group);
    own_ = std::make_unique<OwnNode>(node_);
    node_ = NodeInterfaces(own_->node);
    options_.group = own_->group;
    options_.topic = report_.topic;  // nothing is remapped there
    listen();
    own_->thread.start();
    const std::lock_guard lock(mutex_);
    report_.joined_anew = true;
  }

  rclcpp::TimerBase::SharedPtr addTimer(std::chrono::milliseconds period,
                                        std::function<void()> callback) {
    return rclcpp::create_wall_timer(period, std::move(callback), options_.group, node_.base.get(),
                                     node_.timers.get());
  }

  bool served() const { return pull_client_->service_is_ready(); }

  // The watch of a receiver that nobody else watches for: it warns of what it can't hear.
  void meetPublishers() {
    const Report before = report();
    try {
      if (watch()) subscribe();
    } catch (const std::exception&) {
      if (node_.base->get_context()->is_valid()) throw;
      return;  // ROS has ended
    }
    const Report after = report();
    const auto warn = [this](const char* policy, const char* better) {
      RCLCPP_WARN(logger_,
                  "%s: a publisher is %s beside one that is %s, and isn't heard: end one of them, "
                  "or make it %s, too",
                  report_.topic.c_str(), policy, better, better);
    };
    if (after.best_effort_unheard && !before.best_effort_unheard) warn("best effort", "reliable");
    if (after.volatile_unheard && !before.volatile_unheard) warn("volatile", "transient local");
    if (after.contended) {
      RCLCPP_WARN_THROTTLE(logger_, steady_clock_, kWarningPeriod,
                           "%s: publishers clear each other's map: end all but one of them",
                           report_.topic.c_str());
    }
  }

  void receive(std::shared_ptr<const Message> message) {
    pull_.held = options_.busy();
    // A REPLACE is taken in any case: it drops all that waits.
    if (pull_.held && served() && message->operation != Message::REPLACE) {
      return pull_.miss(labelled(std::move(message)).label, now());
    }
    act(pull_.receive(labelled(std::move(message)), now(), served()));
  }

  void watchForRivals(const std::string& map_id) {
    if (map_id == maps_[0]) return;
    const std::lock_guard lock(mutex_);
    report_.contended |= map_id == maps_[1];
    maps_ = {map_id, maps_[0]};
  }

  void tick() {
    pull_.held = options_.busy();
    act(pull_.tick(now(), served()));
  }

  void act(Pull::Step step) {
    if (step.request) send(*step.request);  // first, so that it is answered meanwhile
    if (step.subscribe_anew) subscribe_anew_ = true;
    if (step.join_anew) join_anew_ = true;
    for (const auto& [message, arrival] : step.batches) {
      if (!passOn(*message, arrival)) {
        pull_.restart(now());
        break;
      }
    }
    const std::lock_guard lock(mutex_);
    report_.pulling = pull_.pulling();
  }

  // Returns false if there was no memory for a batch.
  bool passOn(const Message& message, Arrival arrival) {
    try {
      on_batch_(message, arrival);
      watchForRivals(message.map_id);
      const std::lock_guard lock(mutex_);
      ++report_.batches;
      report_.refusal.clear();
    } catch (const BatchError& error) {
      refuse(error.what());
    } catch (const std::bad_alloc&) {
      refuse("memory is lacking");
      return false;
    }
    return true;
  }

  void refuse(const std::string& why) {
    RCLCPP_ERROR_THROTTLE(logger_, steady_clock_, kWarningPeriod, "%s: a batch is refused: %s",
                          options_.topic.c_str(), printable(why).c_str());
    const std::lock_guard lock(mutex_);
    ++report_.refused;
    report_.refusal = why;
  }

  void send(const Pull::Request& request) {
    auto asked = std::make_shared<PullClient::Request>();
    asked->map_id = request.map_id;
    asked->after_revision = request.after_revision;
    asked->first_block = request.first_block;
    asked->most_sh_degree = options_.most_sh_degree;
    pull_client_->ask(std::move(asked), request.number,
                      [this](std::uint64_t number) { return pull_.awaits(number); });
  }

  void takeAnswer(std::uint64_t number, std::shared_ptr<const PullClient::Response> response) {
    std::vector<Pull::Labelled> batches;
    for (const Message& batch : response->batches) {
      batches.push_back(labelled(std::shared_ptr<const Message>(response, &batch)));
    }
    pull_.held = options_.busy();
    act(pull_.answer(number, std::move(batches), response->next_block, now(), served()));
  }

  NodeInterfaces node_;  // own_'s once there is one
  const OnBatch on_batch_;
  ReceiverOptions options_;
  const rclcpp::Logger logger_;
  rclcpp::Clock steady_clock_{RCL_STEADY_TIME};  // simulated time may stand still
  MapQos chosen_;                                // of the subscription, as publishers are now
  MapQos qos_;                                   // of the subscription
  bool serves_ = false;                          // pulls are, or were while there were publishers
  std::atomic<bool> subscribe_anew_ = false, join_anew_ = false;
  Pull pull_;
  std::array<std::string, 2> maps_;  // ids of the newest map, and of the one before
  mutable std::mutex mutex_;         // report_, but for its topic, which stays
  Report report_;
  std::unique_ptr<OwnNode> own_;  // after joinAnew()
  std::shared_ptr<PullClient> pull_client_;
  rclcpp::Subscription<Message>::SharedPtr map_;
  rclcpp::TimerBase::SharedPtr watch_, tick_;
};

MapReceiver::MapReceiver(const NodeInterfaces& node, OnBatch on_batch,
                         const ReceiverOptions& options)
    : listener_(std::make_unique<Listener>(node, std::move(on_batch), options)) {}

MapReceiver::~MapReceiver() = default;

MapReceiver::Report MapReceiver::report() const { return listener_->report(); }

bool MapReceiver::watch() { return listener_->watch(); }

void MapReceiver::subscribe() { listener_->subscribe(); }

}  // namespace rosplat
