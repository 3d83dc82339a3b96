#include "messages.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "rosplat_core/map/printable.hpp"

namespace rosplat {

static_assert(kMostSlots == kMaxSlots);
static_assert(OrderReader::kPacked == rosplat_msgs::msg::SplatOrder::PACKED);
static_assert(OrderReader::kShared == rosplat_msgs::msg::SplatOrder::SHARED);

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
  const auto& r = camera.rotation;
  const auto& t = camera.translation;
  message.pose.position.x = -(r[0] * t[0] + r[3] * t[1] + r[6] * t[2]);
  message.pose.position.y = -(r[1] * t[0] + r[4] * t[1] + r[7] * t[2]);
  message.pose.position.z = -(r[2] * t[0] + r[5] * t[1] + r[8] * t[2]);
  // The quaternion of the transposed rotation, from its largest component (Shepperd 1978).
  const double trace = r[0] + r[4] + r[8];
  auto& q = message.pose.orientation;
  if (trace > std::fmax(r[0], std::fmax(r[4], r[8]))) {
    const double s = 2 * std::sqrt(1 + trace);
    q.w = s / 4, q.x = (r[5] - r[7]) / s, q.y = (r[6] - r[2]) / s, q.z = (r[1] - r[3]) / s;
  } else if (r[0] >= r[4] && r[0] >= r[8]) {
    const double s = 2 * std::sqrt(1 + r[0] - r[4] - r[8]);
    q.x = s / 4, q.w = (r[5] - r[7]) / s, q.y = (r[1] + r[3]) / s, q.z = (r[2] + r[6]) / s;
  } else if (r[4] >= r[8]) {
    const double s = 2 * std::sqrt(1 + r[4] - r[0] - r[8]);
    q.y = s / 4, q.w = (r[6] - r[2]) / s, q.x = (r[1] + r[3]) / s, q.z = (r[5] + r[7]) / s;
  } else {
    const double s = 2 * std::sqrt(1 + r[8] - r[0] - r[4]);
    q.z = s / 4, q.w = (r[1] - r[3]) / s, q.x = (r[2] + r[6]) / s, q.y = (r[5] + r[7]) / s;
  }
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
  message.pose.position.x = splat.position[0];
  message.pose.position.y = splat.position[1];
  message.pose.position.z = splat.position[2];
  const auto& q = splat.orientation;
  const double norm = std::sqrt(double(q[0]) * q[0] + double(q[1]) * q[1] + double(q[2]) * q[2] +
                                double(q[3]) * q[3]);
  message.pose.orientation.x = q[0] / norm;
  message.pose.orientation.y = q[1] / norm;
  message.pose.orientation.z = q[2] / norm;
  message.pose.orientation.w = q[3] / norm;
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
  if (m.projection > rosplat_msgs::msg::ViewCamera::ORTHOGRAPHIC) {
    throw std::invalid_argument("projection " + std::to_string(m.projection) + " is unknown");
  }
  const auto& p = m.pose.position;
  const auto& q = m.pose.orientation;
  return makeCamera({p.x, p.y, p.z}, {q.x, q.y, q.z, q.w},
                    m.projection == rosplat_msgs::msg::ViewCamera::ORTHOGRAPHIC, m.fx, m.fy, m.cx,
                    m.cy, m.width, m.height, m.near_clip, m.far_clip);
}

}  // namespace rosplat
