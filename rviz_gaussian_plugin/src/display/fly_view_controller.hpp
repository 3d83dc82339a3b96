#pragma once

#include <QString>
#include <chrono>
#include <rviz_common/frame_position_tracking_view_controller.hpp>

#include "fly_motion.hpp"
#include "rosplat_ros/ros_versions.hpp"

class QKeyEvent;

namespace rviz_common::properties {
class FloatProperty;
class VectorProperty;
}  // namespace rviz_common::properties

namespace rosplat {

// Flies through the scene as in a game: W A S D and Q E move, the mouse looks around.
class FlyViewController : public rviz_common::FramePositionTrackingViewController {
  Q_OBJECT

 public:
  FlyViewController();

  void onInitialize() override;
  void update(UpdateDuration wall_dt, UpdateDuration ros_dt) override;
  void handleMouseEvent(rviz_common::ViewportMouseEvent& event) override;
  void lookAt(const Ogre::Vector3& point) override;
  void reset() override;
  void mimic(rviz_common::ViewController* source_view) override;

  // rviz hands on key presses only, and gives its tools' shortcuts ("s" selects) the first choice.
  // So the keys are taken from the events of the render panel and of its window: a click moves the
  // focus to the window until the mouse moves.
  bool eventFilter(QObject* watched, QEvent* event) override;

 protected:
  void onActivate() override;
  void onTargetFrameChanged(const Ogre::Vector3& old_reference_position,
                            const Ogre::Quaternion& old_reference_orientation) override;

 private:
  bool hasFocus() const;
  bool handleFlyKey(const QKeyEvent& event);
  QString underCursor(const rviz_common::ViewportMouseEvent& event);
  void fly();
  void placeCamera();
  Heading heading() const;
  void setHeading(const Heading& heading);

  rviz_common::properties::VectorProperty* position_;
  rviz_common::properties::FloatProperty* yaw_;
  rviz_common::properties::FloatProperty* pitch_;
  rviz_common::properties::FloatProperty* speed_;
  rviz_common::properties::FloatProperty* smoothing_;

  FlyKeys keys_;
  FlyMotion motion_;
  std::chrono::steady_clock::time_point flown_until_;
};

}  // namespace rosplat
