#include "gaussian_display.hpp"

#include <OgreCamera.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreViewport.h>

#include <algorithm>
#include <pluginlib/class_list_macros.hpp>
#include <random>
#include <rviz_common/display_context.hpp>
#include <rviz_common/frame_manager_iface.hpp>
#include <rviz_common/logging.hpp>
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
#include <thread>
#include <utility>

#include "frames.hpp"
#include "messages.hpp"
#include "renderers.hpp"
#include "rosplat_core/map/printable.hpp"

namespace rosplat {

namespace {

using rviz_common::properties::StatusProperty;

// rviz's resource group of exported media.
constexpr const char* kResourceGroup = "rviz_rendering";
constexpr const char* kUnchanged = "As Started";
constexpr const char* kAnyBackend = "auto";
constexpr const char* kGraphics = "OpenGL";  // a line of the Status
constexpr std::chrono::milliseconds kStatusPeriod{500};
constexpr std::chrono::milliseconds kSending{20};  // ten times as long as sending takes

std::string uniqueName() {
  std::random_device device;
  std::ostringstream name;
  name << "rviz_" << std::hex << device();
  return name.str();
}

}  // namespace

GaussianDisplay::GaussianDisplay() {
  topic_ = new rviz_common::properties::RosTopicProperty(
      "Topic", "", MapReceiver::mapType(),
      "Map of 3D Gaussians (rosplat_msgs/GaussianArray). The display publishes its cameras on "
      "<topic>/view and selected splats on <topic>/picked, and takes orders from <topic>/order.",
      this, SLOT(subscribe()));
  qos_property_ = new rviz_common::properties::QosProfileProperty(topic_, qos_);
  scene_file_ = new rviz_common::properties::FilePickerProperty(
      "Scene File", "",
      "Open a scene (.ply, .spz, .sog, .splat, .ksplat, .glb, .usd): the topic's publisher, or one "
      "that is started here, loads it. You can also drop a file on the window. Clear the "
      "property to cancel.",
      this, SLOT(openScene()));
  settings_ = std::make_unique<DisplaySettings>(this, [this] { applySettings(); });
  backend_ =
      new rviz_common::properties::EnumProperty("Sidecar Backend", kUnchanged,
                                                "Switches the backend of all sorters of the map: "
                                                "sets their parameter 'backend'. The Status "
                                                "shows the backend in use.",
                                                this, SLOT(switchBackend()));
  for (const char* name : {kUnchanged, kAnyBackend, "cupy", "torch", "native", "numpy"}) {
    backend_->addOption(name);
  }
  fit_view_ = new rviz_common::properties::BoolProperty(
      "Fit View", false,
      "Check to have an Orbit view show the map: from where its publisher tells at "
      "<topic>/first_view (rosplat_msgs/FirstView), or else from outside. From inside a room, the "
      "Fly view does. Unchecks itself once the view is fitted.",
      this);
  publish_pose_ = new rviz_common::properties::BoolProperty(
      "Publish Camera", false,
      "Publish the pose of the view's camera on <topic>/camera/pose (geometry_msgs/PoseStamped) "
      "and "
      "where it has been on <topic>/camera/path (nav_msgs/Path).",
      this);
  serves_ = new rviz_common::properties::BoolProperty(
      "Render Service", false,
      "Draw the pictures that others ask for at <topic>/render (rosplat_msgs/RenderView). One "
      "display is enough: each that serves draws each picture.",
      this, SLOT(serve()));
}

GaussianDisplay::~GaussianDisplay() { unsubscribe(); }

void GaussianDisplay::onInitialize() {
  Display::onInitialize();
  topic_->initialize(context_->getRosNodeAbstraction());
  if (context_->getWindowManager()) {
    drop_ = std::make_unique<SceneDrop>(context_->getWindowManager()->getParentWindow(),
                                        context_->getViewManager()->getRenderPanel(),
                                        [this](const QString& path) { return openDropped(path); });
  }
  qos_property_->initialize([this](const rclcpp::QoS& qos) {
    qos_ = qos;
    subscribe();
  });
}

void GaussianDisplay::setTopic(const QString& topic, const QString&) { topic_->setString(topic); }

void GaussianDisplay::onEnable() { subscribe(); }

void GaussianDisplay::onDisable() { unsubscribe(); }

void GaussianDisplay::fixedFrameChanged() {
  Display::fixedFrameChanged();
  placed_ = false;
}

void GaussianDisplay::reset() {
  Display::reset();
  if (isEnabled()) subscribe();
}

void GaussianDisplay::unsubscribe() {
  endService();
  diagnostics_.reset();
  view_fit_.reset();
  views_.reset();
  client_.reset();  // no more messages into the cloud
  selection_.reset();
  picks_.reset();
  handles_.reset();
  placed_ = false;
  if (cloud_ && cloud_->isAttached()) cloud_->detachFromParent();
  cloud_.reset();
  shown_status_.clear();
  clearStatuses();
}

void GaussianDisplay::subscribe() {
  if (!initialized()) return;
  unsubscribe();
  if (!isEnabled()) return;
  const std::string topic = topic_->getTopicStd();
  if (topic.empty() && scene_waits_ && !scene_file_->getStdString().empty()) {
    topic_->setStdString(scene_topic_);  // subscribes
    return;
  }
  if (topic.empty()) {
    showStatus({{StatusProperty::Warn, "Topic",
                 "No topic set: choose one of type rosplat_msgs/GaussianArray"}});
    return;
  }
  const std::string name = uniqueName();  // unique among all viewers
  cloud_ = std::make_unique<SplatCloud>(
      name, kResourceGroup, [this](Ogre::Viewport* viewport, const SplatCamera& camera) {
        return onView(viewport, camera);
      });
  cloud_->setBeforeView([this] {
    refuseEmulation();
    if (render_service_) render_service_->serve();
    picks_->refresh();
  });
  scene_node_->attachObject(cloud_.get());
  picks_ = SplatSelection::ofProcess(context_);
  selection_ =
      picks_->of(cloud_.get(), scene_node_,
                 [this](const std::vector<SplatValues>& splats) { publishPicked(splats); });
  applySettings();
  try {
    const auto node = context_->getRosNodeAbstraction().lock()->get_raw_node();
    client_ = std::make_unique<GaussianClient>(node, topic, qos_, cloud_->scene());
    views_ = std::make_unique<DrawnViews>(name, cloud_->scene(), *client_);
    diagnostics_ = std::make_unique<Diagnostics>(*node, client_->status().topic);
    view_fit_ = std::make_unique<ViewFit>(node, client_->status().topic);
    serve();
    const bool other_topic = !loader_ || loader_->topic() != topic;
    if (other_topic) {
      // The file is of the topic that it was chosen for; another one may have its own map.
      if (loader_ && scene_topic_ != topic) scene_file_->setString("");
      loader_ = std::make_unique<SceneLoader>(node, topic);
    }
    if (other_topic || scene_waits_) openScene();
    switchBackend();
  } catch (const std::exception& error) {
    unsubscribe();
    showStatus(
        {{StatusProperty::Error, "Topic", "Can't subscribe to '" + topic + "': " + error.what()}});
  }
}

void GaussianDisplay::applySettings() {
  if (!cloud_) return;
  cloud_->setSettings(settings_->get());
  context_->queueRender();
}

// Without a card rviz would stand still for ten seconds, until all shaders are compiled, and for
// one or more at each frame.
void GaussianDisplay::refuseEmulation() {
  RenderSettings settings = cloud_->settings();
  if (!isEmulated(settings.rasterizer)) return;
  settings.rasterizer = Rasterizer::kProcessor;
  cloud_->setSettings(settings);
}

void GaussianDisplay::openScene() {
  const std::string path = scene_file_->getStdString(), topic = topic_->getTopicStd();
  scene_topic_ = topic.empty() ? "/gaussians" : topic;
  scene_waits_ = !initialized() || !isEnabled();
  if (scene_waits_) return;
  if (path.empty()) {
    if (loader_) loader_->cancel();
    return;
  }
  if (topic.empty()) topic_->setStdString(scene_topic_);
  if (loader_) loader_->load(path);
  fit_view_->setBool(true);
}

bool GaussianDisplay::openDropped(const QString& path) {
  if (!isEnabled()) return false;
  if (scene_file_->getString() == path) {
    openScene();  // loads the file once more
  } else {
    scene_file_->setString(path);
  }
  return true;
}

void GaussianDisplay::switchBackend() {
  const std::string backend = backend_->getStdString();
  if (client_) client_->switchBackend(backend == kUnchanged ? "" : backend);
}

void GaussianDisplay::serve() {
  endService();
  if (!client_ || !serves_->getBool()) return;
  client_->setServing(true);
  render_service_ = std::make_unique<RenderService>(cloud_->getName() + "/render", *cloud_,
                                                    *client_, *context_->getFrameManager());
}

void GaussianDisplay::endService() {
  if (!render_service_) return;
  const std::string why = "the display was turned off or removed, or its service turned off";
  // The middleware sends in a thread of its own, and doesn't tell when it has sent: if a service is
  // destroyed at once, its last answers may be lost.
  if (render_service_->refuse(why)) std::this_thread::sleep_for(kSending);
  client_->setServing(false);
  render_service_->refuse(why);  // requests that have come since
  render_service_.reset();
}

void GaussianDisplay::update(UpdateDuration, UpdateDuration) {
  if (!client_) return;
  client_->watch();
  updateTransform();
  updateHandles();
  fitView();
  views_->update();
  picks_->updateProperties();
  if (render_service_) render_service_->refuseUnserved();
  if (const auto now = std::chrono::steady_clock::now(); now - status_time_ > kStatusPeriod) {
    status_time_ = now;
    settings_->offerChannels(cloud_->scene().state().channels);
    std::vector<StatusLine> lines = statusLines();
    diagnostics_->publish(lines, cloud_->scene(), views_->reports().size());
    showStatus(std::move(lines));
  }
}

void GaussianDisplay::updateTransform() {
  if (placed_ && context_->getFrameManager()->getPause()) return;
  geometry_msgs::msg::PoseStamped map;
  map.header.frame_id = client_->frameId();
  const bool named = !map.header.frame_id.empty();
  const auto pose = named ? inFixedFrame(*context_->getFrameManager(), map) : std::nullopt;
  // Without a transform the map's place is unknown: showing it anywhere would be wrong.
  placed_ = pose.has_value();
  scene_node_->setVisible(placed_);
  cloud_->setVisible(true);  // a hidden cloud would neither upload nor draw pictures for services
  if (placed_) {
    cloud_->setPlace(toPlacement(*pose));
    selection_->follow();
    setTransformOk();
  } else if (named) {
    setMissingTransformToFixedFrame(printable(map.header.frame_id));
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
  handles_->show(settings_->get().clip_box, client_->frameId());
}

void GaussianDisplay::fitView() {
  if (!placed_ || !fit_view_->getBool() || (loader_ && loader_->loading())) return;
  const auto* const panel = context_->getViewManager()->getRenderPanel();
  const double aspect =
      std::max(panel->width(), 1) / static_cast<double>(std::max(panel->height(), 1));
  const auto view = view_fit_->find(client_->frameId(), cloud_->scene().samplePositions(),
                                    *context_->getFrameManager(), aspect);
  if (!view) return;
  moveTo(*view, *context_->getViewManager());
  fit_view_->setBool(false);
}

std::string GaussianDisplay::onView(const Ogre::Viewport* viewport, const SplatCamera& camera) {
  if (!placed_) return "";
  const bool main =
      viewport == context_->getViewManager()->getCurrent()->getCamera()->getViewport();
  const bool orders_wanted = cloud_->settings().order == OrderSource::kSidecar;
  return views_->draw(viewport, camera, main, orders_wanted, publish_pose_->getBool()).id();
}

void GaussianDisplay::publishPicked(const std::vector<SplatValues>& splats) {
  if (!client_) return;
  const MapState& map = cloud_->scene().drawnMap();
  for (const SplatValues& splat : splats) {
    client_->publish(toMessage(splat, client_->header(), map));
  }
}

std::vector<StatusLine> GaussianDisplay::statusLines() {
  const GaussianClient::Status received = client_->status();
  const SplatScene& scene = cloud_->scene();
  const MapState map = scene.state();
  const auto views = views_->reports();

  std::vector<StatusLine> lines{topicStatus(received)};
  if (loader_ && !loader_->status().empty()) {
    lines.push_back(sceneFileStatus(loader_->status(), loader_->loading(), loader_->failed(), map));
  }
  if (!received.sidecar.text.empty()) {
    const std::string backend = backend_->getStdString();
    const bool any = backend == kUnchanged || backend == kAnyBackend;
    lines.push_back(sidecarStatus(received, any ? "" : backend, views));
  } else if (cloud_->settings().order == OrderSource::kSidecar && received.sorters == 0) {
    lines.push_back(noSorterStatus(received.topic));
  }
  if (received.batches > 0) lines.push_back(mapStatus(map, scene.backlog()));
  const bool draws = cloud_->error().empty();
  if (const std::string error = draws ? scene.error() : cloud_->error(); !error.empty()) {
    lines.push_back({StatusProperty::Error, kGraphics, error});
  } else if (const std::string warning = scene.warning(); !warning.empty()) {
    lines.push_back({StatusProperty::Warn, kGraphics, warning});
  } else if (settings_->get().rasterizer != cloud_->settings().rasterizer) {
    lines.push_back({StatusProperty::Warn, kGraphics,
                     "no graphics card draws here: the processor does, not Tiles, which would take "
                     "seconds a picture; set Rasterizer to Auto"});
  }
  if (!draws || received.batches == 0) return lines;
  if (const std::string error = settings_->detailError(); !error.empty()) {
    lines.push_back({StatusProperty::Error, "Detail", error + "; all is drawn"});
  }
  if (cloud_->settings().mode == DrawMode::kChannel) {
    lines.push_back(channelStatus(map, cloud_->settings()));
  }
  const Detail wanted = cloud_->settings().drawnDetail();
  const DrawnBytes bytes = scene.bytes();
  std::vector<SplatCamera> cameras;
  for (const auto& [view, frame, camera] : views) {
    cameras.push_back(camera);
    if (frame.order_source.empty()) continue;  // nothing is drawn yet
    lines.push_back(orderStatus(frame, view));
    lines.push_back(frameStatus(frame, view));
    if (frame.paint_time > 0) lines.push_back(pictureStatus(frame, view));
    if (!(wanted == Detail{})) {
      lines.push_back(detailStatus(wanted, frame, bytes.levels, view));
    }
  }
  const auto regimes = scene.hardRegimes(cloud_->settings(), cameras);
  if (!regimes.empty()) lines.push_back(accuracyStatus(regimes));
  const auto [nearest, farthest] = cloud_->settings().depth_range;
  if (cloud_->settings().mode == DrawMode::kDepth && nearest >= farthest && nearest > 0) {
    lines.push_back({StatusProperty::Warn, "Depth Range",
                     "Farthest is not beyond Nearest: colours span the depths in view"});
  }
  lines.push_back(memoryStatus(bytes.gpu, bytes.host, bytes.shared_gpu, bytes.shared_host));
  return lines;
}

void GaussianDisplay::showStatus(std::vector<StatusLine> lines) {
  for (StatusLine& line : lines) line.text = printable(line.text);  // some text is a peer's
  const auto contains = [](const std::vector<StatusLine>& among, const auto& like) {
    return std::any_of(among.begin(), among.end(), like);
  };
  for (const StatusLine& line : lines) {
    const auto same = [&](const StatusLine& other) { return other == line; };
    if (contains(shown_status_, same)) continue;
    setStatusStd(line.level, line.name, line.text);
    if (line.name == kGraphics) RVIZ_COMMON_LOG_WARNING_STREAM(getNameStd() << ": " << line.text);
  }
  for (const StatusLine& line : shown_status_) {
    const auto named = [&](const StatusLine& other) { return other.name == line.name; };
    if (!contains(lines, named)) deleteStatusStd(line.name);
  }
  shown_status_ = std::move(lines);
}

}  // namespace rosplat

PLUGINLIB_EXPORT_CLASS(rosplat::GaussianDisplay, rviz_common::Display)
