#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/msg/gaussian.hpp>
#include <rosplat_msgs/msg/splat_order.hpp>
#include <rosplat_msgs/msg/view_camera.hpp>
#include <rosplat_msgs/srv/render_view.hpp>
#include <set>
#include <std_msgs/msg/header.hpp>
#include <string>

#include "camera_trail.hpp"
#include "fair_queue.hpp"
#include "rosplat_core/order/order_slots.hpp"
#include "rosplat_ros/group_thread.hpp"
#include "rosplat_ros/map_receiver.hpp"
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
  struct Status : MapReceiver::Report {
    std::string frame_id;           // of the map
    std::string unheard;            // a publisher's QoS that may be why no batch arrives
    bool other_user = false;        // another user's programs share memory on this machine
    std::size_t sorters = 0;        // that publish orders
    std::string dropped_order;      // why the last order was dropped; empty if it wasn't
    SidecarSwitch::Report sidecar;  // what became of switchBackend()
  };

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
  using SplatOrder = rosplat_msgs::msg::SplatOrder;
  using Pause = GroupThread::Pause;
  static constexpr std::size_t kMostRequests = 64;  // waiting requests for pictures

  void apply(const MapReceiver::GaussianArray& message, Arrival arrival);
  void receive(SplatOrder& message);
  void dropOrder(const std::string& why);
  void watchPublishers();

  rclcpp::Node::SharedPtr node_;
  rclcpp::Clock steady_clock_{RCL_STEADY_TIME};  // simulated time may stand still
  std::string topic_;                            // as given to the constructor
  std::string remapped_;                         // as ROS resolves it; prefix of the other topics
  SplatScene& scene_;
  rclcpp::CallbackGroup::SharedPtr group_;
  double watched_ = 0;  // time of the last watch [s]
  std::unique_ptr<MapReceiver> map_;
  rclcpp::Subscription<SplatOrder>::SharedPtr orders_;
  rclcpp::Publisher<rosplat_msgs::msg::ViewCamera>::SharedPtr view_publisher_;
  std::atomic<bool> views_followed_ = false;
  std::atomic<bool> other_user_ = false;
  std::atomic<std::size_t> sorters_ = 0;
  rclcpp::Publisher<rosplat_msgs::msg::Gaussian>::SharedPtr picked_publisher_;
  rclcpp::Service<RenderView>::SharedPtr render_service_;
  std::unique_ptr<CameraTrail> trail_;  // if poses are published
  std::unique_ptr<SidecarSwitch> sidecar_;
  OrderReader reader_;

  mutable std::mutex mutex_;              // frame_id_, dropped_order_, requests_, views_
  std::string frame_id_, dropped_order_;  // as Status has them
  FairQueue<std::string, RenderRequest> requests_{kMostRequests};
  std::set<std::string> views_;  // published and not forgotten: their orders are read

  std::unique_ptr<GroupThread> receiving_;  // after what its callbacks use
};

}  // namespace rosplat
