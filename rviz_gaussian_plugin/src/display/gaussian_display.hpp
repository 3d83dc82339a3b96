#pragma once

#include <map>
#include <memory>
#include <optional>
#include <rviz_common/display.hpp>
#include <string>
#include <utility>

#include "../splats/splat_cloud.hpp"
#include "clip_box_handles.hpp"
#include "display_settings.hpp"
#include "gaussian_client.hpp"
#include "ros_versions.hpp"
#include "scene_drop.hpp"
#include "scene_loader.hpp"
#include "splat_selection.hpp"

namespace rviz_common::properties {
class BoolProperty;
class EnumProperty;
class FilePickerProperty;
class QosProfileProperty;
class RosTopicProperty;
}  // namespace rviz_common::properties

namespace rosplat {

// Shows the map of a GaussianArray topic: properties, frames, status. What is drawn is SplatCloud's
// business, what is received GaussianClient's.
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

 private Q_SLOTS:
  void subscribe();
  void openScene();
  void switchBackend();

 private:
  // A viewport that the map is drawn in.
  struct View {
    std::string id;
    std::size_t number = 0;
    std::uint64_t sequence = 0;
    SplatCamera camera;
    double published = 0;  // when the camera last went out [s]
    double drawn = 0;      // when it was last seen [s]
    int updates = 0;       // of the display, since then
    bool main = false;     // rviz's own, not a Camera display's, say
  };

  void unsubscribe();
  bool takeDrop(const QString& path);
  void applySettings();
  std::string onView(Ogre::Viewport* viewport, const SplatCamera& camera);
  void forgetUnseenViews();
  void askAgain(View& view);
  void publish(View& view);
  void serveRenderRequests();
  void refuseUnserved();
  void refuseRenderRequests(const std::string& why);
  void answer(const GaussianClient::RenderRequest& request, bool built_in);
  void publishPicked(const std::vector<SplatValues>& splats);
  bool toMapFrame(rosplat_msgs::msg::ViewCamera& camera) const;
  void updateTransform();
  void updateHandles();
  void updateStatus();
  // Says who sorts, where the sidecar uses another backend than it was asked for.
  std::string unwantedBackend() const;
  void showFrame(const View& view);
  static QString statusName(const char* entry, const View& view);
  void setStatusOnce(rviz_common::properties::StatusProperty::Level level, const QString& name,
                     const std::string& text);
  void removeStatus(const QString& name);

  rviz_common::properties::RosTopicProperty* topic_;
  rviz_common::properties::QosProfileProperty* qos_property_;
  rclcpp::QoS qos_ = GaussianClient::mapQos();
  rviz_common::properties::FilePickerProperty* scene_file_;
  rviz_common::properties::EnumProperty* backend_;
  rviz_common::properties::BoolProperty* publish_pose_;
  std::unique_ptr<DisplaySettings> settings_;

  std::string instance_;  // names this display's views among all viewers'
  std::unique_ptr<SplatCloud> cloud_;
  std::unique_ptr<GaussianClient> client_;  // after cloud_: feeds it
  std::shared_ptr<SplatSelection> selection_;
  std::unique_ptr<SceneLoader> loader_;
  std::unique_ptr<SceneDrop> drop_;
  std::unique_ptr<ClipBoxHandles> handles_;
  std::map<Ogre::Viewport*, View> views_;
  std::size_t view_count_ = 0;  // that there ever were
  View still_;                  // of the pictures that services ask for
  std::optional<GaussianClient::RenderRequest> request_;
  double request_deadline_ = 0;
  bool served_ = false;  // requests were looked at since the last update
  double unserved_ = 0;  // since when they were not [s]
  bool placed_ = false;  // there is a map, and where it belongs is known
  double status_time_ = 0;
  std::map<QString, std::pair<rviz_common::properties::StatusProperty::Level, std::string>>
      shown_status_;
};

}  // namespace rosplat
