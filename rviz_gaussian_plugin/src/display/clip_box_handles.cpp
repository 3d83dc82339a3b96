#include "clip_box_handles.hpp"

#include <OgreSceneManager.h>
#include <OgreSceneNode.h>

#include <QObject>
#include <algorithm>
#include <rviz_common/display_context.hpp>
#include <rviz_default_plugins/displays/interactive_markers/interactive_marker.hpp>
#include <visualization_msgs/msg/interactive_marker.hpp>
#include <visualization_msgs/msg/interactive_marker_control.hpp>
#include <visualization_msgs/msg/interactive_marker_feedback.hpp>
#include <visualization_msgs/msg/marker.hpp>

namespace rosplat {

namespace {

using rviz_default_plugins::displays::InteractiveMarker;
using visualization_msgs::msg::InteractiveMarkerControl;
using visualization_msgs::msg::InteractiveMarkerFeedback;
using visualization_msgs::msg::Marker;

// Sizes relative to the box's longest edge.
constexpr float kHandle = 0.1f;
constexpr float kLine = 0.01f;
constexpr float kLeast = 1e-3f;  // the least edge: no face passes the opposite one [m]

geometry_msgs::msg::Point point(const std::array<float, 3>& p) {
  geometry_msgs::msg::Point message;
  message.x = p[0];
  message.y = p[1];
  message.z = p[2];
  return message;
}

Marker marker(int type, float scale, const std::array<float, 3>& color) {
  Marker message;
  message.ns = "clip box";
  message.type = type;
  message.pose.orientation.w = 1;
  message.scale.x = message.scale.y = message.scale.z = scale;
  message.color.r = color[0];
  message.color.g = color[1];
  message.color.b = color[2];
  message.color.a = 1;
  return message;
}

// The box's edges about its middle.
Marker edges(const std::array<float, 3>& size, float width) {
  Marker lines = marker(Marker::LINE_LIST, width, {0.9f, 0.9f, 0.9f});
  for (int corner = 0; corner < 8; ++corner) {
    for (int axis = 0; axis < 3; ++axis) {
      if (corner >> axis & 1) continue;  // an edge begins at its lower end
      std::array<float, 3> end{};
      for (int i = 0; i < 3; ++i) end[i] = (corner >> i & 1 ? 0.5f : -0.5f) * size[i];
      lines.points.push_back(point(end));
      end[axis] = -end[axis];
      lines.points.push_back(point(end));
    }
  }
  return lines;
}

}  // namespace

ClipBoxHandles::ClipBoxHandles(rviz_common::DisplayContext* context, DragCallback on_drag)
    : context_(context),
      on_drag_(std::move(on_drag)),
      node_(context->getSceneManager()->getRootSceneNode()->createChildSceneNode()) {
  for (std::size_t handle = 0; handle < markers_.size(); ++handle) {
    markers_[handle] = std::make_unique<InteractiveMarker>(node_, context);
    QObject::connect(markers_[handle].get(), &InteractiveMarker::userFeedback,
                     [this, handle](InteractiveMarkerFeedback& feedback) {
                       if (feedback.event_type == InteractiveMarkerFeedback::MOUSE_DOWN) {
                         dragged_ = handle;
                       } else if (feedback.event_type == InteractiveMarkerFeedback::MOUSE_UP) {
                         dragged_.reset();
                         frame_id_.clear();  // so that show() places all handles
                       } else if (dragged_ == handle) {
                         const auto& to = feedback.pose.position;
                         drag(handle, {float(to.x), float(to.y), float(to.z)});
                       }
                     });
  }
}

ClipBoxHandles::~ClipBoxHandles() {
  markers_ = {};
  context_->getSceneManager()->destroySceneNode(node_);
}

void ClipBoxHandles::show(const ClipBox& box, const std::string& frame_id) {
  if (!(box == box_) || frame_id != frame_id_) {
    box_ = box;
    frame_id_ = frame_id;
    for (std::size_t handle = 0; handle < markers_.size(); ++handle) {
      if (dragged_ != handle) place(handle);
    }
  }
  for (const auto& marker : markers_) marker->update();
}

void ClipBoxHandles::place(std::size_t handle) {
  const float longest = *std::max_element(box_.size.begin(), box_.size.end());
  const std::size_t axis = handle / 2;
  std::array<float, 3> position = box_.centre;
  std::array<float, 3> color{1, 1, 1};
  visualization_msgs::msg::InteractiveMarker message;
  message.header.frame_id = frame_id_;
  message.name = "clip box " + std::to_string(handle);
  message.scale = longest;
  InteractiveMarkerControl control;
  control.name = "handle";
  control.always_visible = true;
  control.interaction_mode = InteractiveMarkerControl::MOVE_3D;
  control.orientation.w = 1;
  if (handle != kMiddle) {
    position[axis] += (handle % 2 ? 0.5f : -0.5f) * box_.size[axis];
    color = {axis == 0 ? 0.9f : 0.1f, axis == 1 ? 0.8f : 0.1f, axis == 2 ? 1.0f : 0.1f};
    control.interaction_mode = InteractiveMarkerControl::MOVE_AXIS;  // along the turned x axis
    if (axis == 1) control.orientation.z = 1;
    if (axis == 2) control.orientation.y = 1;
  }
  control.markers.push_back(marker(Marker::SPHERE, kHandle * longest, color));
  control.markers.back().id = static_cast<int>(handle);
  message.controls.push_back(control);
  if (handle == kMiddle) {
    InteractiveMarkerControl outline;
    outline.name = "outline";
    outline.always_visible = true;
    outline.interaction_mode = InteractiveMarkerControl::NONE;
    outline.orientation.w = 1;
    outline.markers.push_back(edges(box_.size, kLine * longest));
    message.controls.push_back(outline);
  }
  message.pose.position = point(position);
  message.pose.orientation.w = 1;
  markers_[handle]->processMessage(message);
  markers_[handle]->setShowAxes(false);
  markers_[handle]->setShowDescription(false);
}

void ClipBoxHandles::drag(std::size_t handle, const std::array<float, 3>& to) {
  ClipBox box = box_;
  if (handle == kMiddle) {
    box.centre = to;
  } else {
    const std::size_t axis = handle / 2;
    const float half = 0.5f * box.size[axis];
    float low = box.centre[axis] - half, high = box.centre[axis] + half;
    if (handle % 2) {
      high = std::max(to[axis], low + kLeast);
    } else {
      low = std::min(to[axis], high - kLeast);
    }
    box.centre[axis] = 0.5f * (low + high);
    box.size[axis] = high - low;
  }
  if (!(box == box_)) on_drag_(box);
}

}  // namespace rosplat
