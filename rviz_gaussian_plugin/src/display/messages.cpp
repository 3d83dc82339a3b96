#include "messages.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "rosplat_core/map/printable.hpp"

namespace rosplat {

static_assert(kMostSlots == kMaxSlots);
static_assert(OrderReader::kPacked == rosplat_msgs::msg::SplatOrder::PACKED);
static_assert(OrderReader::kShared == rosplat_msgs::msg::SplatOrder::SHARED);

namespace {

geometry_msgs::msg::Point toPoint(const std::array<double, 3>& p) {
  geometry_msgs::msg::Point point;
  std::tie(point.x, point.y, point.z) = std::tuple_cat(p);
  return point;
}

// Of unit length.
geometry_msgs::msg::Quaternion toQuaternion(const std::array<double, 4>& q) {
  const double length = std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
  geometry_msgs::msg::Quaternion unit;
  std::tie(unit.x, unit.y, unit.z, unit.w) =
      std::tuple(q[0] / length, q[1] / length, q[2] / length, q[3] / length);
  return unit;
}

}  // namespace

void toOrder(rosplat_msgs::msg::SplatOrder& message, std::size_t most, OrderReader& reader,
             Order& order) {
  order.view_id = message.view_id;
  order.sequence = message.sequence;
  order.map_id = message.map_id;
  order.revision = message.revision;
  order.source = "sidecar (" + printable(message.backend, 40) + ")";
  order.sort_time = message.sort_time;
  if (message.encoding == rosplat_msgs::msg::SplatOrder::SLOTS) {
    checkCount(message.slots.size(), most);
    order.slots = std::move(message.slots);
    order.bound = boundOf(order.slots.data(), order.slots.size());
  } else {
    order.bound =
        reader.read(message.encoding, message.packed.data(), message.packed.size(), message.count,
                    message.slot_bits, message.segment, message.generation, order.slots, most);
  }
}

rosplat_msgs::msg::ViewCamera toMessage(const SplatCamera& camera, const std::string& view_id,
                                        std::uint64_t sequence,
                                        const std_msgs::msg::Header& header) {
  rosplat_msgs::msg::ViewCamera message;
  message.header = header;
  message.view_id = view_id;
  message.sequence = sequence;
  const Placement pose = camera.inverse();
  message.pose.position = toPoint(pose.translation);
  message.pose.orientation = toQuaternion(quaternionOf(pose.rotation));
  message.projection = camera.orthographic ? rosplat_msgs::msg::ViewCamera::ORTHOGRAPHIC
                                           : rosplat_msgs::msg::ViewCamera::PERSPECTIVE;
  message.fx = camera.fx;
  message.fy = camera.fy;
  message.cx = camera.cx;
  message.cy = camera.cy;
  message.width = static_cast<std::uint32_t>(camera.width);
  message.height = static_cast<std::uint32_t>(camera.height);
  message.near_clip = camera.near_clip;
  message.far_clip = camera.far_clip;
  message.extent_scale = camera.extent_scale;
  return message;
}

rosplat_msgs::msg::Gaussian toMessage(const SplatValues& splat, const std_msgs::msg::Header& header,
                                      const MapState& map) {
  rosplat_msgs::msg::Gaussian message;
  message.header = header;
  message.map_id = map.id;
  message.revision = map.revision;
  message.slot = splat.slot;
  message.group = splat.group;
  message.pose.position = toPoint(splat.position);
  const auto& [qx, qy, qz, qw] = splat.orientation;
  message.pose.orientation = toQuaternion({qx, qy, qz, qw});
  message.scale.x = splat.scale[0];
  message.scale.y = splat.scale[1];
  message.scale.z = splat.scale[2];
  message.opacity = splat.opacity;
  message.sh_degree =
      static_cast<std::uint8_t>(std::lround(std::sqrt(double(splat.sh.size()) / 3)) - 1);
  message.sh = splat.sh;
  for (std::size_t i = 0; i < std::min(map.channels.size(), splat.channels.size()); ++i) {
    message.channel_names.push_back(map.channels[i].name);
    message.channels.push_back(std::isfinite(splat.channels[i]) ? splat.channels[i] : kNoValue);
  }
  return message;
}

Placement toPlacement(const geometry_msgs::msg::Pose& pose) {
  const auto& p = pose.position;
  const auto& q = pose.orientation;
  return makePlacement({p.x, p.y, p.z}, {q.x, q.y, q.z, q.w});
}

SplatCamera toCamera(const rosplat_msgs::msg::ViewCamera& m) {
  using rosplat_msgs::msg::ViewCamera;
  if (m.projection == ViewCamera::EQUIRECTANGULAR) {
    throw std::invalid_argument(
        "projection is EQUIRECTANGULAR: rviz draws no panorama, the viewer with serve does");
  }
  if (m.projection > ViewCamera::ORTHOGRAPHIC) {
    throw std::invalid_argument("projection is " + std::to_string(m.projection) +
                                ", known are 0 and 1");
  }
  const auto& p = m.pose.position;
  const auto& q = m.pose.orientation;
  return makeCamera({p.x, p.y, p.z}, {q.x, q.y, q.z, q.w}, m.projection == ViewCamera::ORTHOGRAPHIC,
                    m.fx, m.fy, m.cx, m.cy, m.width, m.height, m.near_clip, m.far_clip);
}

}  // namespace rosplat
