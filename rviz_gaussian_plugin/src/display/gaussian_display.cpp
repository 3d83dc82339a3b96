#include "gaussian_display.hpp"

#include <OgreCamera.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreViewport.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <iomanip>
#include <pluginlib/class_list_macros.hpp>
#include <random>
#include <rviz_common/display_context.hpp>
#include <rviz_common/frame_manager_iface.hpp>
#include <rviz_common/properties/bool_property.hpp>
#include <rviz_common/properties/enum_property.hpp>
#include <rviz_common/properties/file_picker_property.hpp>
#include <rviz_common/properties/qos_profile_property.hpp>
#include <rviz_common/properties/ros_topic_property.hpp>
#include <rviz_common/render_panel.hpp>
#include <rviz_common/ros_integration/ros_node_abstraction_iface.hpp>
#include <rviz_common/view_controller.hpp>
#include <rviz_common/view_manager.hpp>
#include <rviz_common/window_manager_interface.hpp>
#include <sstream>

#include "messages.hpp"

namespace rosplat {

namespace {

using rviz_common::properties::StatusProperty;

// rviz's resource group of exported media.
constexpr const char* kResourceGroup = "rviz_rendering";
// A view's camera goes out at least this often, so that a sorter that starts late learns of it. [s]
constexpr double kKeepAlive = 1.0;
constexpr double kAskAgain =
    0.25;  // how long a picture waits for an order before it asks again [s]
constexpr double kLongestWait = 60.0;  // for the order of a picture that a service asks for [s]
constexpr double kUnserved = 1.0;      // after which nobody will draw what services ask for [s]
constexpr double kUnseen = 2.0;        // after which a view that isn't drawn is gone [s]
constexpr const char* kUnchanged = "As Started";
constexpr const char* kAnyBackend = "auto";
constexpr double kStatusPeriod = 0.5;  // [s]
constexpr const char* kOrderStatus = "Order";
constexpr const char* kFrameStatus = "Frame";

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::string uniqueName() {
  std::random_device device;
  std::ostringstream name;
  name << "rviz_" << std::hex << device();
  return name.str();
}

template <typename... Parts>
std::string concat(const Parts&... parts) {
  std::ostringstream text;
  text << std::fixed << std::setprecision(1);
  (text << ... << parts);
  return text.str();
}

}  // namespace

GaussianDisplay::GaussianDisplay() : instance_(uniqueName()) {
  topic_ = new rviz_common::properties::RosTopicProperty(
      "Topic", "", GaussianClient::mapType(),
      "Map of 3D Gaussians (rosplat_msgs/GaussianArray). The display publishes its cameras on "
      "<topic>/view and what is selected on <topic>/picked, takes orders from <topic>/order and "
      "draws pictures for <topic>/render.",
      this, SLOT(subscribe()));
  qos_property_ = new rviz_common::properties::QosProfileProperty(topic_, qos_);
  scene_file_ = new rviz_common::properties::FilePickerProperty(
      "Scene File", "",
      "Open a scene (.ply, .spz, .sog): the topic's publisher loads it, or one that is started "
      "here. A file may be dropped on the window, too. Empty it to cancel.",
      this, SLOT(openScene()));
  settings_ = std::make_unique<DisplaySettings>(this, [this] { applySettings(); });
  backend_ = new rviz_common::properties::EnumProperty(
      "Sidecar Backend", kUnchanged,
      "What the sidecar sorts with: sets its parameter 'backend'. The Status shows what it uses.",
      this, SLOT(switchBackend()));
  for (const char* name : {kUnchanged, kAnyBackend, "cupy", "torch", "native", "numpy"}) {
    backend_->addOption(name);
  }
  publish_pose_ = new rviz_common::properties::BoolProperty(
      "Publish Camera", false,
      "Publish the pose of the view's camera on <topic>/camera/pose (geometry_msgs/PoseStamped) "
      "and "
      "where it has been on <topic>/camera/path (nav_msgs/Path).",
      this);
}

GaussianDisplay::~GaussianDisplay() {
  client_.reset();  // no more messages into the cloud
  selection_.reset();
  if (cloud_ && cloud_->isAttached()) cloud_->detachFromParent();
}

void GaussianDisplay::onInitialize() {
  Display::onInitialize();
  topic_->initialize(context_->getRosNodeAbstraction());
  if (context_->getWindowManager()) {
    drop_ = std::make_unique<SceneDrop>(context_->getWindowManager()->getParentWindow(),
                                        context_->getViewManager()->getRenderPanel(),
                                        [this](const QString& path) { return takeDrop(path); });
  }
  qos_property_->initialize([this](const rclcpp::QoS& qos) {
    qos_ = qos;
    subscribe();
  });
}

void GaussianDisplay::setTopic(const QString& topic, const QString&) { topic_->setString(topic); }

void GaussianDisplay::onEnable() { subscribe(); }

void GaussianDisplay::onDisable() { unsubscribe(); }

void GaussianDisplay::reset() {
  Display::reset();
  if (isEnabled()) subscribe();
}

void GaussianDisplay::unsubscribe() {
  if (client_) refuseRenderRequests("the display was turned off");
  client_.reset();
  selection_.reset();
  handles_.reset();
  served_ = true;
  placed_ = false;
  if (cloud_ && cloud_->isAttached()) cloud_->detachFromParent();
  cloud_.reset();
  views_.clear();
  shown_status_.clear();
  clearStatuses();
}

void GaussianDisplay::subscribe() {
  if (!initialized()) return;
  unsubscribe();
  if (!isEnabled()) return;
  const std::string topic = topic_->getTopicStd();
  if (topic.empty()) {
    setStatusOnce(StatusProperty::Warn, "Topic",
                  "No topic set: choose one of type rosplat_msgs/GaussianArray");
    return;
  }
  cloud_ = std::make_unique<SplatCloud>(
      instance_, kResourceGroup, [this](Ogre::Viewport* viewport, const SplatCamera& camera) {
        return onView(viewport, camera);
      });
  scene_node_->attachObject(cloud_.get());
  selection_ = rviz_common::interaction::createSelectionHandler<SplatSelection>(
      context_, cloud_.get(), scene_node_,
      [this](const std::vector<SplatValues>& splats) { publishPicked(splats); });
  selection_->addTrackedObject(cloud_.get());
  applySettings();
  try {
    const auto node = context_->getRosNodeAbstraction().lock()->get_raw_node();
    client_ = std::make_unique<GaussianClient>(node, topic, qos_, cloud_->scene());
    if (!loader_ || loader_->topic() != topic) {
      loader_ = std::make_unique<SceneLoader>(node, topic);
      openScene();
    }
    switchBackend();
  } catch (const std::exception& error) {
    unsubscribe();
    setStatusOnce(StatusProperty::Error, "Topic", concat("Can't subscribe: ", error.what()));
  }
}

void GaussianDisplay::applySettings() {
  if (!cloud_) return;
  cloud_->setSettings(settings_->get());
  context_->queueRender();
}

void GaussianDisplay::openScene() {
  if (!initialized() || !isEnabled()) return;
  const std::string path = scene_file_->getStdString();
  if (path.empty()) {
    if (loader_) loader_->cancel();
    return;
  }
  if (topic_->getTopicStd().empty()) topic_->setString("/gaussians");
  if (loader_) loader_->load(path);
}

bool GaussianDisplay::takeDrop(const QString& path) {
  if (!isEnabled()) return false;
  if (scene_file_->getString() == path) {
    openScene();  // once more
  } else {
    scene_file_->setString(path);
  }
  return true;
}

void GaussianDisplay::switchBackend() {
  const std::string backend = backend_->getStdString();
  if (client_) client_->switchBackend(backend == kUnchanged ? "" : backend);
}

void GaussianDisplay::update(UpdateDuration, UpdateDuration) {
  if (!client_) return;
  updateTransform();
  updateHandles();
  forgetUnseenViews();
  refuseUnserved();
  for (auto& [viewport, view] : views_) {
    if (view.sequence == 0 || now() - view.published < kKeepAlive) continue;
    // A view or an order may have been lost while display and sorter got to know each other.
    const FrameReport report = cloud_->scene().report(view.id);
    if (report.order_source.rfind("sidecar", 0) != 0 || !report.order_fresh) askAgain(view);
    publish(view);
  }
  if (now() - status_time_ > kStatusPeriod) {
    status_time_ = now();
    updateStatus();
  }
}

void GaussianDisplay::updateTransform() {
  const std::string frame = client_->status().frame_id;
  Ogre::Vector3 position;
  Ogre::Quaternion orientation;
  const bool known =
      frame.empty() || context_->getFrameManager()->getTransform(frame, position, orientation);
  // Where the map belongs nobody knows: showing it somewhere would be wrong.
  placed_ = known && !frame.empty();
  scene_node_->setVisible(placed_);
  cloud_->setVisible(true);  // or it would neither upload nor draw pictures for services
  if (!known) {
    setMissingTransformToFixedFrame(frame);
  } else if (!frame.empty()) {
    scene_node_->setPosition(position);
    scene_node_->setOrientation(orientation);
    setTransformOk();
  }
}

void GaussianDisplay::updateHandles() {
  if (!placed_ || !settings_->clipBoxIsDragged()) {
    handles_.reset();
    return;
  }
  if (!handles_) {
    handles_ = std::make_unique<ClipBoxHandles>(
        context_, [this](const ClipBox& box) { settings_->setClipBox(box); });
  }
  handles_->show(settings_->get().clip_box, client_->status().frame_id);
}

void GaussianDisplay::forgetUnseenViews() {
  for (auto view = views_.begin(); view != views_.end();) {
    const bool by_a_slow_frame = ++view->second.updates == 1;
    if (by_a_slow_frame || now() - view->second.drawn < kUnseen) {
      ++view;
      continue;
    }
    cloud_->scene().forget(view->second.id);
    for (const char* entry : {kOrderStatus, kFrameStatus}) {
      removeStatus(statusName(entry, view->second));
    }
    view = views_.erase(view);
  }
}

std::string GaussianDisplay::onView(Ogre::Viewport* viewport, const SplatCamera& camera) {
  serveRenderRequests();  // here, where the context is current
  selection_->refresh();
  if (!placed_) return "";
  View& view = views_[viewport];
  if (view.id.empty()) {
    view.number = ++view_count_;
    view.id = instance_ + "/" + std::to_string(view.number);
  }
  view.drawn = now();
  view.updates = 0;
  view.main = viewport == context_->getViewManager()->getCurrent()->getCamera()->getViewport();
  if (view.sequence == 0 || !(view.camera == camera)) {
    view.camera = camera;
    ++view.sequence;
    publish(view);
  }
  cloud_->scene().setCamera(view.id, view.sequence, camera);
  return view.id;
}

void GaussianDisplay::askAgain(View& view) {
  ++view.sequence;
  cloud_->scene().setCamera(view.id, view.sequence, view.camera);
}

void GaussianDisplay::publish(View& view) {
  view.published = now();
  const rclcpp::Time stamp = context_->getClock()->now();
  const auto message =
      toMessage(view.camera, view.id, view.sequence, client_->status().frame_id, stamp);
  client_->publish(message);
  if (publish_pose_->getBool() && view.main) client_->publishPose(message);
}

void GaussianDisplay::publishPicked(const std::vector<SplatValues>& splats) {
  if (!client_) return;
  std_msgs::msg::Header header;
  header.frame_id = client_->status().frame_id;
  header.stamp = context_->getClock()->now();
  const MapState& map = cloud_->scene().drawnMap();
  for (const SplatValues& splat : splats) {
    client_->publish(toMessage(splat, header, map.id, map.revision));
  }
}

bool GaussianDisplay::toMapFrame(rosplat_msgs::msg::ViewCamera& camera) const {
  const std::string map_frame = client_->status().frame_id;
  const std::string& frame = camera.header.frame_id;
  if (frame.empty() || frame == map_frame) return true;
  Ogre::Vector3 map_position, position;
  Ogre::Quaternion map_orientation, orientation;
  auto* frames = context_->getFrameManager();
  if (!frames->getTransform(map_frame, map_position, map_orientation) ||
      !frames->transform(frame, rclcpp::Time(camera.header.stamp, RCL_ROS_TIME), camera.pose,
                         position, orientation)) {
    return false;
  }
  position = map_orientation.Inverse() * (position - map_position);
  orientation = map_orientation.Inverse() * orientation;
  camera.pose.position.x = position.x;
  camera.pose.position.y = position.y;
  camera.pose.position.z = position.z;
  camera.pose.orientation.x = orientation.x;
  camera.pose.orientation.y = orientation.y;
  camera.pose.orientation.z = orientation.z;
  camera.pose.orientation.w = orientation.w;
  return true;
}

void GaussianDisplay::refuseUnserved() {
  if (std::exchange(served_, false)) {
    unserved_ = now();
  } else if (now() - unserved_ > kUnserved) {
    refuseRenderRequests(cloud_->error().empty() ? "rviz draws nothing" : cloud_->error());
  }
}

void GaussianDisplay::refuseRenderRequests(const std::string& why) {
  if (!request_) request_ = client_->takeRenderRequest();
  for (; request_; request_ = client_->takeRenderRequest()) {
    request_->refuse(why);
  }
}

void GaussianDisplay::serveRenderRequests() {
  served_ = true;
  if (!client_) return;
  if (!request_) {
    request_ = client_->takeRenderRequest();
    if (!request_) return;
    rosplat_msgs::msg::ViewCamera camera = request_->request->camera;
    try {
      if (!toMapFrame(camera)) {
        throw std::invalid_argument("camera.header.frame_id: no transform from '" +
                                    camera.header.frame_id + "' to the map");
      }
      still_.id = instance_ + "/render";
      still_.camera = toCamera(camera);
      still_.camera.extent_scale = extentScale(cloud_->settings());
    } catch (const std::invalid_argument& error) {
      request_->refuse(error.what());
      request_.reset();
      return;
    }
    ++still_.sequence;
    cloud_->scene().setCamera(still_.id, still_.sequence, still_.camera);
    publish(still_);
    request_deadline_ = now() + std::min(request_->request->order_timeout, kLongestWait);
  }
  const bool answered = cloud_->scene().answered(still_.id);
  if (!answered && now() - still_.published > kAskAgain) {
    askAgain(still_);
    publish(still_);
  }
  if (!answered && now() < request_deadline_) return;
  answer(*request_, !answered);
  request_.reset();
}

void GaussianDisplay::answer(const GaussianClient::RenderRequest& request, bool built_in) {
  GaussianClient::RenderView::Response response;
  try {
    SplatScene& scene = cloud_->scene();
    const FrameReport report = scene.draw(still_.id, cloud_->settings(), Canvas::kNone, built_in);
    const auto fill = [&](sensor_msgs::msg::Image& image, const std::vector<float>& pixels,
                          const char* encoding) {
      image.header.frame_id = request.request->camera.header.frame_id;
      image.header.stamp = request.request->camera.header.stamp;
      image.width = static_cast<std::uint32_t>(still_.camera.width);
      image.height = static_cast<std::uint32_t>(still_.camera.height);
      image.encoding = encoding;
      image.step = static_cast<std::uint32_t>(pixels.size() * sizeof(float) / image.height);
      image.data.resize(pixels.size() * sizeof(float));
      std::memcpy(image.data.data(), pixels.data(), image.data.size());
    };
    fill(response.color, scene.readColor(), "32FC4");
    fill(response.depth, scene.readDepth(), "32FC1");
    const MapState map = scene.state();
    response.splats = report.splats;
    response.order_source = report.order_source;
    response.sort_time = report.sort_time;
    response.draw_time = report.draw_time;
    response.map_id = map.id;
    response.revision = map.revision;
    response.map_complete = map.splats > 0 && map.splats + map.dropped >= map.expected;
    response.success = true;
  } catch (const std::exception& error) {
    response.message = error.what();
  }
  request.answer(response);
}

void GaussianDisplay::setStatusOnce(StatusProperty::Level level, const QString& name,
                                    const std::string& text) {
  auto& shown = shown_status_[name];
  if (shown == std::make_pair(level, text)) return;
  shown = {level, text};
  setStatus(level, name, QString::fromStdString(text));
}

void GaussianDisplay::removeStatus(const QString& name) {
  if (shown_status_.erase(name) > 0) deleteStatus(name);
}

void GaussianDisplay::updateStatus() {
  const GaussianClient::Status received = client_->status();
  const MapState map = cloud_->scene().state();

  if (received.refused > 0) {
    setStatusOnce(
        StatusProperty::Error, "Topic",
        concat(received.refused, " batches refused, the last because ", received.refusal));
  } else if (received.batches == 0 && !received.other_type.empty()) {
    setStatusOnce(StatusProperty::Error, "Topic",
                  concat("This topic is of type ", received.other_type, ": choose one of type ",
                         GaussianClient::mapType()));
  } else if (received.batches == 0) {
    setStatusOnce(StatusProperty::Warn, "Topic",
                  received.publishers.empty() ? "Nobody publishes on this topic"
                  : received.unheard.empty()
                      ? "No batch received yet"
                      : concat("No batch received: a publisher is ", received.unheard));
  } else if (received.contended) {
    std::string names;
    for (const std::string& name : received.publishers) names += (names.empty() ? "" : ", ") + name;
    setStatusOnce(StatusProperty::Warn, "Topic",
                  concat("Publishers clear each other's map, end all but one of: ", names));
  } else {
    setStatusOnce(StatusProperty::Ok, "Topic", concat(received.batches, " batches received"));
  }

  if (loader_ && !loader_->status().empty()) {
    std::string text = loader_->status();
    if (loader_->loading() && map.expected > map.splats) {
      text += concat("; ", map.splats, " of ", map.expected, " splats are here");
    }
    setStatusOnce(loader_->failed() ? StatusProperty::Error : StatusProperty::Ok, "Scene File",
                  text);
  } else {
    removeStatus("Scene File");
  }
  if (!received.sidecar.empty()) {
    const std::string unwanted = unwantedBackend();
    const bool obeys = !received.sidecar_failed && unwanted.empty();
    setStatusOnce(obeys ? StatusProperty::Ok : StatusProperty::Warn, "Sidecar",
                  received.sidecar + unwanted);
  } else {
    removeStatus("Sidecar");
  }

  if (received.batches > 0) {
    std::string text = concat(map.splats, " splats");
    if (map.expected > map.splats) text += concat(" of ", map.expected);
    text += concat(", SH degree ", map.sh_degree, map.antialiased ? ", antialiased" : "");
    if (map.missed > 0) text += concat("; ", map.missed, " batches are missing");
    if (map.dropped > 0) text += concat("; ", map.dropped, " splats with invalid values left out");
    setStatusOnce(map.missed + map.dropped > 0 ? StatusProperty::Warn : StatusProperty::Ok, "Map",
                  text);
  }

  const std::string& error =
      cloud_->error().empty() ? cloud_->scene().uploadError() : cloud_->error();
  if (!error.empty()) {
    setStatusOnce(StatusProperty::Error, "OpenGL", error);
  } else {
    removeStatus("OpenGL");
  }
  if (!cloud_->error().empty()) return;
  if (received.batches == 0) return;
  for (const auto& [viewport, view] : views_) showFrame(view);
  setStatusOnce(StatusProperty::Ok, "Memory",
                concat("GPU ", cloud_->scene().gpuBytes() >> 20, " MiB, host ",
                       cloud_->scene().hostBytes() >> 20, " MiB"));
}

std::string GaussianDisplay::unwantedBackend() const {
  const std::string wanted = backend_->getStdString();
  if (wanted == kUnchanged || wanted == kAnyBackend) return "";
  for (const auto& [viewport, view] : views_) {
    const std::string source = cloud_->scene().report(view.id).order_source;
    if (source.rfind("sidecar (", 0) == 0 && source.rfind("sidecar (" + wanted + ")", 0) != 0) {
      return ", but the order is by " + source + ": its log says why";
    }
  }
  return "";
}

QString GaussianDisplay::statusName(const char* entry, const View& view) {
  return view.main ? QString(entry) : QString("%1 (view %2)").arg(entry).arg(view.number);
}

void GaussianDisplay::showFrame(const View& view) {
  const FrameReport frame = cloud_->scene().report(view.id);
  if (frame.order_source.empty()) return;
  setStatusOnce(
      StatusProperty::Ok, statusName(kOrderStatus, view),
      concat(frame.splats, " splats by ", frame.order_source,
             frame.sort_time > 0 ? concat(" in ", frame.sort_time * 1e3, " ms") : "", ", ",
             frame.order_fresh ? "fresh" : concat(frame.order_age * 1e3, " ms old")));
  std::string text = concat(frame.draw_time * 1e3, " ms to draw in ", frame.rasterizer);
  for (const auto& [stage, time] : frame.profile) {
    text += concat(", ", stage, " ", std::setprecision(2), time * 1e3);
  }
  setStatusOnce(StatusProperty::Ok, statusName(kFrameStatus, view), text);
}

}  // namespace rosplat

PLUGINLIB_EXPORT_CLASS(rosplat::GaussianDisplay, rviz_common::Display)
