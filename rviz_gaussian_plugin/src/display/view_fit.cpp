#include "view_fit.hpp"

#include <OgreVector3.h>

#include <algorithm>
#include <cmath>
#include <rviz_common/properties/property.hpp>
#include <rviz_common/view_controller.hpp>
#include <rviz_common/view_manager.hpp>
#include <utility>

#include "frames.hpp"

namespace rosplat {

namespace {

constexpr double kTurn = 2 * 3.14159265358979323846;
constexpr double kFieldOfView = kTurn / 8;    // rviz's, from top to bottom [rad]
constexpr std::chrono::seconds kPatience{2};  // for an offer, once there is a map
constexpr double kSecondsAcross = 4;          // in which the Fly view gets to the target

std::array<double, 3> numbers(const geometry_msgs::msg::Point& p) { return {p.x, p.y, p.z}; }

// A point of a frame in the Fixed Frame. [m]
std::optional<std::array<double, 3>> fixed(const geometry_msgs::msg::Point& point,
                                           const std::string& frame,
                                           rviz_common::FrameManagerIface& frames) {
  geometry_msgs::msg::PoseStamped pose;
  pose.header.frame_id = frame;
  pose.pose.position = point;
  const auto found = inFixedFrame(frames, pose);
  if (!found) return std::nullopt;
  return numbers(found->position);
}

}  // namespace

OrbitView orbitOf(const std::array<double, 3>& eye, const std::array<double, 3>& target,
                  double width, double aspect) {
  const double x = eye[0] - target[0], y = eye[1] - target[1], z = eye[2] - target[2];
  const double yaw = std::atan2(y, x);
  const double distance = std::sqrt(x * x + y * y + z * z) * std::max(1.0, width / aspect);
  return {target, std::max(distance, 1e-6), yaw < 0 ? yaw + kTurn : yaw,
          std::atan2(z, std::hypot(x, y))};
}

OrbitView orbitAround(std::vector<std::array<double, 3>> positions, double aspect) {
  std::array<double, 3> middle{};
  double square = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto at = [&](std::size_t percent) {
      const auto place =
          positions.begin() + static_cast<std::ptrdiff_t>((positions.size() - 1) * percent / 100);
      std::nth_element(positions.begin(), place, positions.end(),
                       [axis](const auto& a, const auto& b) { return a[axis] < b[axis]; });
      return (*place)[axis];
    };
    const double low = at(5), high = at(95);
    middle[axis] = (low + high) / 2;
    square += (high - low) * (high - low);
  }
  const double slope = std::tan(kFieldOfView / 2) * std::min(1.0, aspect);
  const double distance = std::sqrt(square) / 2 / std::sin(std::atan(slope));
  return {middle, std::max(distance, 0.05), 0.8, 0.42};
}

ViewFit::ViewFit(const rclcpp::Node::SharedPtr& node, const std::string& topic) {
  subscription_ = node->create_subscription<rosplat_msgs::msg::FirstView>(
      topic + "/first_view", rclcpp::QoS(1).reliable().transient_local(),
      [this](rosplat_msgs::msg::FirstView::ConstSharedPtr view) { offered_ = *view; });
}

std::optional<OrbitView> ViewFit::find(const std::string& frame,
                                       const std::vector<std::array<double, 3>>& positions,
                                       rviz_common::FrameManagerIface& frames, double aspect) {
  if (positions.empty()) return std::nullopt;
  const auto now = std::chrono::steady_clock::now();
  if (!since_) since_ = now;
  if (offered_) {
    const auto eye = fixed(offered_->eye, offered_->header.frame_id, frames);
    const auto target = fixed(offered_->target, offered_->header.frame_id, frames);
    if (eye && target &&
        std::isfinite((*eye)[0] + (*eye)[1] + (*eye)[2] + (*target)[0] + (*target)[1] +
                      (*target)[2] + offered_->width)) {
      OrbitView view = orbitOf(*eye, *target, offered_->width, aspect);
      view.inside = offered_->inside;
      return view;
    }
  }
  if (now - *since_ < kPatience) return std::nullopt;
  std::vector<std::array<double, 3>> placed;
  for (const auto& [x, y, z] : positions) {
    geometry_msgs::msg::Point point;
    point.x = x, point.y = y, point.z = z;
    if (const auto found = fixed(point, frame, frames)) placed.push_back(*found);
  }
  if (placed.empty()) return std::nullopt;
  return orbitAround(std::move(placed), aspect);
}

void moveTo(const OrbitView& view, rviz_common::ViewManager& views) {
  const auto set = [](rviz_common::properties::Property* vector, const Ogre::Vector3& point) {
    vector->subProp("X")->setValue(point.x);
    vector->subProp("Y")->setValue(point.y);
    vector->subProp("Z")->setValue(point.z);
  };
  const auto [x, y, z] = view.target;
  const Ogre::Vector3 target(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z));
  if (view.inside) {
    views.setCurrentViewControllerType("rviz_gaussian_plugin/Fly");
    rviz_common::ViewController& fly = *views.getCurrent();
    const double flat = std::cos(view.pitch) * view.distance;
    const Ogre::Vector3 away(static_cast<float>(flat * std::cos(view.yaw)),
                             static_cast<float>(flat * std::sin(view.yaw)),
                             static_cast<float>(view.distance * std::sin(view.pitch)));
    set(fly.subProp("Position"), target + away);
    fly.subProp("Speed")->setValue(view.distance / kSecondsAcross);
    fly.lookAt(target);
    return;
  }
  rviz_common::ViewController& controller = *views.getCurrent();
  auto* const distance = controller.subProp("Distance");
  auto* const focus = controller.subProp("Focal Point");
  controller.lookAt(target);
  // subProp() gives a property without a name where there is none.
  if (distance->getName() != "Distance" || focus->getName() != "Focal Point") return;
  set(focus, target);
  distance->setValue(view.distance);
  controller.subProp("Yaw")->setValue(view.yaw);
  controller.subProp("Pitch")->setValue(view.pitch);
}

}  // namespace rosplat
