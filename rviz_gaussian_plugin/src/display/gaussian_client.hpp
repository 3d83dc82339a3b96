#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/msg/gaussian.hpp>
#include <rosplat_msgs/msg/gaussian_array.hpp>
#include <rosplat_msgs/msg/splat_order.hpp>
#include <rosplat_msgs/msg/view_camera.hpp>
#include <rosplat_msgs/srv/render_view.hpp>
#include <set>
#include <std_msgs/msg/header.hpp>
#include <string>
#include <thread>
#include <vector>

#include "camera_trail.hpp"
#include "fair_queue.hpp"
#include "pull_client.hpp"
#include "rosplat_core/map/map_pull.hpp"
#include "rosplat_core/map/map_qos.hpp"
#include "rosplat_core/order/order_slots.hpp"
#include "sidecar_switch.hpp"
#include "splat_scene.hpp"

namespace rosplat {

// The ROS side of a display: feeds a scene from a map's topic and its sorter's, in a thread of its
// own so that no message holds up the GUI. For a map on /gaussians, missing parts are pulled from
// /gaussians/pull, views go out on /gaussians/view, orders come in on /gaussians/order, and clients
// ask for pictures at /gaussians/render.
class GaussianClient {
 public:
  using RenderView = rosplat_msgs::srv::RenderView;

  // A client's request for a picture.
  struct RenderRequest {
    std::shared_ptr<rclcpp::Service<RenderView>> service;
    std::shared_ptr<rmw_request_id_t> id;
    std::shared_ptr<RenderView::Request> request;
    void answer(RenderView::Response& response) const;
    void refuse(const std::string& why) const;
  };

  // What has arrived.
  struct Status {
    std::string topic;     // of the map, as it is remapped
    std::string frame_id;  // of the map
    std::uint64_t batches = 0;
    std::uint64_t refused = 0;            // batches that contradict themselves
    std::string refusal;                  // of the last batch; empty if it was taken
    std::string dropped_order;            // why the last order was dropped; empty if it wasn't
    std::vector<std::string> publishers;  // nodes that publish on the map's topic
    bool contended = false;               // a map came back after another had replaced it
    std::string other_type;               // type that a publisher has instead of mapType()
    std::string unheard;                  // a publisher's QoS that may be why no batch arrives
    SidecarSwitch::Report sidecar;        // what became of switchBackend()
  };

  static const char* mapType();  // of the map's topic
  // The QoS that publishers of maps offer: reliable, transient local, as deep as their history.
  static rclcpp::QoS mapQos();

  // The scene must outlive the client. The subscription asks for less than qos where chooseMapQos()
  // says so. Throws rclcpp's exceptions for a topic with an invalid name.
  GaussianClient(const rclcpp::Node::SharedPtr& node, const std::string& topic,
                 const rclcpp::QoS& qos, SplatScene& scene);
  ~GaussianClient();

  // Looks at the topic's publishers, at most once a second. Call it again and again from the thread
  // that constructed the client: only one thread may make a node's subscriptions and clients.
  void watch();
  // Publishes a view. A sequence above 0 asks for an order.
  void publish(rosplat_msgs::msg::ViewCamera view);
  // Whether the views have other subscribers than sorters, a streaming publisher for example.
  bool viewsFollowed() const { return views_followed_; }
  // Forgets a view: orders for it are ignored from now on.
  void forget(const std::string& view_id);
  // Publishes a splat that the mouse has picked.
  void publish(const rosplat_msgs::msg::Gaussian& picked) { picked_publisher_->publish(picked); }
  // Publishes the pose of a view and its path, for other displays.
  void publishPose(const rosplat_msgs::msg::ViewCamera& view);
  // Sets the parameter `backend` of all nodes that publish orders, now or later; empty: stops that.
  void switchBackend(const std::string& backend) { sidecar_->ask(backend); }
  // Starts or ends the render service.
  void setServing(bool serving);
  // The next waiting request; clients take turns.
  std::optional<RenderRequest> takeRenderRequest();
  bool renderRequestsWait() const;
  Status status() const;
  std::string frameId() const;           // of the map
  std_msgs::msg::Header header() const;  // the map's frame, and the time now

 private:
  using GaussianArray = rosplat_msgs::msg::GaussianArray;
  using SplatOrder = rosplat_msgs::msg::SplatOrder;
  using Pull = MapPull<std::shared_ptr<const GaussianArray>>;
  static constexpr std::size_t kMostRequests = 64;  // waiting requests for pictures

  // Stops the executor within its scope: while messages arrive, rclcpp's executor (Jazzy) may miss
  // a subscription that another thread makes, and never wait for it.
  struct Pause {
    explicit Pause(GaussianClient& client) : of(client) { of.stop(); }
    ~Pause() { of.start(); }
    Pause(const Pause&) = delete;
    Pause& operator=(const Pause&) = delete;

    GaussianClient& of;
  };
  void start();
  void stop();
  void subscribe(const MapQos& qos);
  void hear(std::shared_ptr<const GaussianArray> message);
  void tick();
  bool isFull() const;
  void note(const std::string& map_id);
  void act(Pull::Step step);
  void send(const Pull::Request& request);
  void takeAnswer(std::uint64_t number, std::shared_ptr<const PullClient::Response> response);
  // Returns false if there was no memory for a batch.
  bool take(const GaussianArray& message, Arrival arrival);
  bool served() const { return pull_client_->service_is_ready(); }
  void refuse(const std::string& why);
  void receive(SplatOrder& message);
  void dropOrder(const std::string& why);
  void watchPublishers();

  rclcpp::Node::SharedPtr node_;
  rclcpp::Clock steady_clock_{RCL_STEADY_TIME};  // simulated time may stand still
  std::string topic_;                            // as given to the constructor
  std::string remapped_;                         // as ROS resolves it; prefix of the other topics
  SplatScene& scene_;
  rclcpp::CallbackGroup::SharedPtr group_;
  double watched_ = 0;   // time of the last watch [s]
  rclcpp::QoS wished_;   // that the user asked for
  MapQos qos_;           // of the subscription
  bool serves_ = false;  // pulls are answered, or were while there were publishers
  std::atomic<bool> subscribe_anew_ = false;
  rclcpp::Subscription<GaussianArray>::SharedPtr map_;
  Pull pull_;
  std::shared_ptr<PullClient> pull_client_;
  rclcpp::Subscription<SplatOrder>::SharedPtr orders_;
  rclcpp::Publisher<rosplat_msgs::msg::ViewCamera>::SharedPtr view_publisher_;
  std::atomic<bool> views_followed_ = false;
  rclcpp::Publisher<rosplat_msgs::msg::Gaussian>::SharedPtr picked_publisher_;
  rclcpp::Service<RenderView>::SharedPtr render_service_;
  rclcpp::TimerBase::SharedPtr pull_tick_;
  std::unique_ptr<CameraTrail> trail_;  // if poses are published
  std::unique_ptr<SidecarSwitch> sidecar_;
  OrderReader reader_;

  mutable std::mutex mutex_;  // status_, requests_, views_
  Status status_;
  std::array<std::string, 2> maps_;  // ids of the newest map, and of the one before
  FairQueue<std::string, RenderRequest> requests_{kMostRequests};
  std::set<std::string> views_;  // published and not forgotten: their orders are read

  rclcpp::executors::SingleThreadedExecutor executor_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace rosplat
