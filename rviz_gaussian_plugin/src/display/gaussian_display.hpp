#pragma once

#include <chrono>
#include <memory>
#include <rviz_common/display.hpp>
#include <string>
#include <vector>

#include "clip_box_handles.hpp"
#include "diagnostics.hpp"
#include "display_settings.hpp"
#include "display_status.hpp"
#include "drawn_views.hpp"
#include "gaussian_client.hpp"
#include "render_service.hpp"
#include "rosplat_ros/ros_versions.hpp"
#include "scene_drop.hpp"
#include "scene_loader.hpp"
#include "splat_cloud.hpp"
#include "splat_selection.hpp"
#include "view_fit.hpp"

namespace rviz_common::properties {
class BoolProperty;
class EnumProperty;
class FilePickerProperty;
class QosProfileProperty;
class RosTopicProperty;
}  // namespace rviz_common::properties

namespace rosplat {

// Shows the map of a GaussianArray topic. Holds the properties and connects the parts: SplatCloud
// draws, GaussianClient receives.
class GaussianDisplay : public rviz_common::Display {
  Q_OBJECT

 public:
  GaussianDisplay();
  ~GaussianDisplay() override;

  void setTopic(const QString& topic, const QString& datatype) override;
  void update(UpdateDuration wall_dt, UpdateDuration ros_dt) override;
  void reset() override;

 protected:
  void onInitialize() override;
  void onEnable() override;
  void onDisable() override;
  void fixedFrameChanged() override;

 private Q_SLOTS:
  void subscribe();
  void openScene();
  void switchBackend();
  void serve();

 private:
  void unsubscribe();
  void endService();
  bool openDropped(const QString& path);
  void applySettings();
  void refuseEmulation();
  std::string onView(const Ogre::Viewport* viewport, const SplatCamera& camera);
  void publishPicked(const std::vector<SplatValues>& splats);
  void updateTransform();
  void updateHandles();
  void fitView();
  std::vector<StatusLine> statusLines();
  // Shows these lines and none of those shown before; rviz's own stay.
  void showStatus(std::vector<StatusLine> lines);

  rviz_common::properties::RosTopicProperty* topic_;
  rviz_common::properties::QosProfileProperty* qos_property_;
  rclcpp::QoS qos_ = mapQos();
  rviz_common::properties::FilePickerProperty* scene_file_;
  rviz_common::properties::EnumProperty* backend_;
  rviz_common::properties::BoolProperty* fit_view_;  // checked until the view is fitted
  rviz_common::properties::BoolProperty* publish_pose_;
  rviz_common::properties::BoolProperty* serves_;
  std::unique_ptr<DisplaySettings> settings_;

  std::unique_ptr<SplatCloud> cloud_;
  std::unique_ptr<GaussianClient> client_;  // after cloud_: feeds it
  std::unique_ptr<DrawnViews> views_;       // after client_, as the next
  std::unique_ptr<ViewFit> view_fit_;
  std::unique_ptr<Diagnostics> diagnostics_;
  std::unique_ptr<RenderService> render_service_;  // if it serves
  std::shared_ptr<SplatSelection> picks_;          // of all displays
  std::shared_ptr<MapSelection> selection_;        // of this one
  std::unique_ptr<SceneLoader> loader_;
  std::string scene_topic_;   // that the scene file was chosen for
  bool scene_waits_ = false;  // it was chosen while the display was disabled
  std::unique_ptr<SceneDrop> drop_;
  std::unique_ptr<ClipBoxHandles> handles_;
  bool placed_ = false;  // there is a map, and its pose in the Fixed Frame is known
  std::vector<StatusLine> shown_status_;
  std::chrono::steady_clock::time_point status_time_;
};

}  // namespace rosplat
