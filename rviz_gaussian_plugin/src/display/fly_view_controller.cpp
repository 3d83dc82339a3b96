#undef QT_NO_KEYWORDS  // rviz_rendering/render_window.hpp uses Qt's keywords
#include "fly_view_controller.hpp"

#include <OgreCamera.h>
#include <OgreQuaternion.h>
#include <OgreSceneNode.h>

#include <QGuiApplication>
#include <QKeyEvent>
#include <algorithm>
#include <cmath>
#include <pluginlib/class_list_macros.hpp>
#include <rviz_common/display_context.hpp>
#include <rviz_common/interaction/view_picker_iface.hpp>
#include <rviz_common/properties/bool_property.hpp>
#include <rviz_common/properties/float_property.hpp>
#include <rviz_common/properties/vector_property.hpp>
#include <rviz_common/render_panel.hpp>
#include <rviz_common/tool.hpp>
#include <rviz_common/tool_manager.hpp>
#include <rviz_common/view_manager.hpp>
#include <rviz_common/viewport_mouse_event.hpp>
#include <rviz_rendering/geometry.hpp>
#include <rviz_rendering/render_window.hpp>

namespace rosplat {

namespace {

using rviz_common::properties::FloatProperty;

const Ogre::Vector3 kHome(-5, -5, 4);  // [m]
// Short of the vertical, where yaw can't be told from a picture.
constexpr float kMaxPitch = 1.5697963f;           // [rad]
constexpr float kRadiansPerPixel = 0.005f;        // as rviz's other views
constexpr float kSpeedStep = 1.2f;                // of one notch of the wheel
constexpr float kWheelNotch = 120;                // Qt's eighths of a degree
constexpr std::chrono::milliseconds kStall{500};  // limits the flight of a frame that took longer

bool FlyKeys::* flyKey(int key) {
  switch (key) {
    case Qt::Key_W:
      return &FlyKeys::forward;
    case Qt::Key_S:
      return &FlyKeys::back;
    case Qt::Key_A:
      return &FlyKeys::left;
    case Qt::Key_D:
      return &FlyKeys::right;
    case Qt::Key_E:
      return &FlyKeys::up;
    case Qt::Key_Q:
      return &FlyKeys::down;
    case Qt::Key_Shift:
      return &FlyKeys::fast;
    default:
      return nullptr;
  }
}

// A tool may ask for all keys; rviz's Select does, but takes none of these.
bool isForTool(const rviz_common::Tool* tool) {
  return tool && tool->accessAllKeys() && tool->getClassId() != "rviz_default_plugins/Select";
}

}  // namespace

FlyViewController::FlyViewController() {
  position_ = new rviz_common::properties::VectorProperty(
      "Position", kHome, "Position of the camera in the target frame. [m]", this);
  yaw_ = new FloatProperty("Yaw", 0, "Direction of view about the Z (up) axis. [rad]", this);
  pitch_ = new FloatProperty("Pitch", 0, "How much the camera is tipped downward. [rad]", this);
  pitch_->setMin(-kMaxPitch);
  pitch_->setMax(kMaxPitch);
  speed_ = new FloatProperty(
      "Speed", 2, "Speed of flight; the mouse wheel changes it, Shift makes it fourfold. [m/s]",
      this);
  speed_->setMin(0.001f);
  speed_->setMax(1000);
  smoothing_ = new FloatProperty(
      "Smoothing", 0.15f,
      "Time constant in which the camera gets up to speed and comes to rest; 0 is at once. [s]",
      this);
  smoothing_->setMin(0);
  smoothing_->setMax(5);
  setHeading(headingOf(-kHome, Ogre::Vector3::UNIT_Z));
}

void FlyViewController::onInitialize() {
  FramePositionTrackingViewController::onInitialize();
  camera_->setProjectionType(Ogre::PT_PERSPECTIVE);
  invert_z_->hide();  // z is up
  setCursor(Rotate3D);
}

void FlyViewController::onActivate() {
  FramePositionTrackingViewController::onActivate();
  rviz_common::RenderPanel* panel = context_->getViewManager()->getRenderPanel();
  panel->installEventFilter(this);
  panel->getRenderWindow()->installEventFilter(this);
  flown_until_ = std::chrono::steady_clock::now();
}

bool FlyViewController::eventFilter(QObject* watched, QEvent* event) {
  switch (event->type()) {
    case QEvent::ShortcutOverride:
    case QEvent::KeyPress:
    case QEvent::KeyRelease:
      if (handleFlyKey(*static_cast<QKeyEvent*>(event))) {
        event->accept();
        return true;
      }
      break;
    case QEvent::FocusOut:
      if (!hasFocus()) {  // key releases will go elsewhere
        fly();
        keys_ = {};
      }
      break;
    default:
      break;
  }
  return FramePositionTrackingViewController::eventFilter(watched, event);
}

bool FlyViewController::hasFocus() const {
  rviz_common::RenderPanel* panel = context_->getViewManager()->getRenderPanel();
  return panel->hasFocus() || QGuiApplication::focusWindow() == panel->getRenderWindow();
}

bool FlyViewController::handleFlyKey(const QKeyEvent& event) {
  bool FlyKeys::* key = flyKey(event.key());
  if (!key) return false;
  const bool release = event.type() == QEvent::KeyRelease;
  if (!release) {
    if (event.modifiers() & (Qt::ControlModifier | Qt::AltModifier | Qt::MetaModifier))
      return false;
    if (isForTool(context_->getToolManager()->getCurrentTool())) return false;
  }
  if (event.type() == QEvent::ShortcutOverride) return true;
  // Held keys repeat as presses and releases.
  if (release && event.isAutoRepeat()) return true;
  fly();
  keys_.*key = !release;
  context_->queueRender();
  return true;
}

void FlyViewController::update(UpdateDuration wall_dt, UpdateDuration ros_dt) {
  FramePositionTrackingViewController::update(wall_dt, ros_dt);
  fly();
  placeCamera();
}

// Flies up to now, on its own clock: each key acts from the moment of its event, not of a frame.
void FlyViewController::fly() {
  const auto now = std::chrono::steady_clock::now();
  const std::chrono::duration<float> dt =
      std::min<std::chrono::steady_clock::duration>(now - flown_until_, kStall);
  flown_until_ = now;
  const Ogre::Vector3 target = flyVelocity(keys_, heading(), speed_->getFloat());
  const Ogre::Vector3 way = motion_.advance(target, dt.count(), smoothing_->getFloat());
  if (way != Ogre::Vector3::ZERO) position_->add(way);
}

void FlyViewController::handleMouseEvent(rviz_common::ViewportMouseEvent& event) {
  if (event.type == QEvent::MouseMove && event.left()) {
    fly();
    Heading turned = heading();
    turned.yaw -= kRadiansPerPixel * static_cast<float>(event.x - event.last_x);
    turned.pitch += kRadiansPerPixel * static_cast<float>(event.y - event.last_y);
    setHeading(turned);
    context_->queueRender();
  }
  if (event.wheel_delta != 0) {
    fly();
    const float notches = static_cast<float>(event.wheel_delta) / kWheelNotch;
    speed_->setFloat(speed_->getFloat() * std::pow(kSpeedStep, notches));
  }
  setStatus(underCursor(event) +
            QString("<b>W A S D:</b> Fly.  <b>Q/E:</b> Down/Up.  <b>Shift:</b> Faster.  "
                    "<b>Left-Click:</b> Look around.  <b>Mouse Wheel:</b> Speed, %1 m/s.")
                .arg(speed_->getFloat(), 0, 'g', 3));
}

// The surface's point under the cursor, as text. Empty if there is none or a mouse button is down.
QString FlyViewController::underCursor(const rviz_common::ViewportMouseEvent& event) {
  Ogre::Vector3 point;
  if (event.buttons_down != Qt::NoButton ||
      !context_->getViewPicker()->get3DPoint(event.panel, event.x, event.y, point)) {
    return {};
  }
  const Ogre::Vector3 seen = camera_->getViewMatrix() * point;  // the camera looks along -z
  return QString("[%1, %2, %3], depth %4 m.  ")
      .arg(point.x, 0, 'f', 3)
      .arg(point.y, 0, 'f', 3)
      .arg(point.z, 0, 'f', 3)
      .arg(-seen.z, 0, 'f', 3);
}

void FlyViewController::lookAt(const Ogre::Vector3& point) {
  const Ogre::Vector3 direction = point - (reference_position_ + position_->getVector());
  if (direction == Ogre::Vector3::ZERO) return;
  setHeading(headingOf(direction, heading().forward()));
  context_->queueRender();
}

void FlyViewController::reset() {
  motion_.stop();
  position_->setVector(kHome);
  lookAt(reference_position_);
}

void FlyViewController::mimic(rviz_common::ViewController* source_view) {
  FramePositionTrackingViewController::mimic(source_view);
  const Ogre::Camera* camera = source_view->getCamera();
  const Ogre::Quaternion orientation = camera->getDerivedOrientation();
  Ogre::Vector3 position = camera->getDerivedPosition() - reference_position_;
  if (camera->getProjectionType() == Ogre::PT_ORTHOGRAPHIC) {
    // A view from the top may have any height: fly where as much of the ground is in sight.
    const float half_height = 1 / static_cast<float>(camera->getProjectionMatrix()[1][1]);
    position.z = half_height / std::tan(camera_->getFOVy().valueRadians() / 2);
  }
  position_->setVector(position);
  setHeading(
      headingOf(orientation * Ogre::Vector3::NEGATIVE_UNIT_Z, orientation * Ogre::Vector3::UNIT_Y));
}

void FlyViewController::onTargetFrameChanged(const Ogre::Vector3& old_reference_position,
                                             const Ogre::Quaternion&) {
  position_->add(old_reference_position - reference_position_);
}

void FlyViewController::placeCamera() {
  const Heading looking = heading();
  const Ogre::Vector3 back = -looking.forward();
  const Ogre::Vector3 right = -looking.left();
  camera_scene_node_->setOrientation(Ogre::Quaternion(right, back.crossProduct(right), back));
  camera_scene_node_->setPosition(position_->getVector());
}

Heading FlyViewController::heading() const { return {yaw_->getFloat(), pitch_->getFloat()}; }

void FlyViewController::setHeading(const Heading& heading) {
  yaw_->setFloat(rviz_rendering::mapAngleTo0_2Pi(heading.yaw));
  pitch_->setFloat(heading.pitch);  // within its limits
}

}  // namespace rosplat

PLUGINLIB_EXPORT_CLASS(rosplat::FlyViewController, rviz_common::ViewController)
