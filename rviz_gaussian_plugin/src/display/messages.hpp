#pragma once

#include <rosplat_msgs/msg/gaussian.hpp>
#include <rosplat_msgs/msg/splat_order.hpp>
#include <rosplat_msgs/msg/view_camera.hpp>
#include <std_msgs/msg/header.hpp>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/order/order_slots.hpp"
#include "rosplat_core/views/splat_camera.hpp"

// Conversions between the renderer's own types and ROS messages.
namespace rosplat {

// Fills an order. Takes its slots, `most` at most, from the message or from the shared memory that
// the message names. Throws OrderError.
void toOrder(rosplat_msgs::msg::SplatOrder& message, std::size_t most, OrderReader& reader,
             Order& order);

rosplat_msgs::msg::ViewCamera toMessage(const SplatCamera& camera, const std::string& view_id,
                                        std::uint64_t sequence,
                                        const std_msgs::msg::Header& header);

// The orientation becomes a unit quaternion.
rosplat_msgs::msg::Gaussian toMessage(const SplatValues& splat, const std_msgs::msg::Header& header,
                                      const MapState& map);

Placement toPlacement(const geometry_msgs::msg::Pose& pose);

// Throws std::invalid_argument, naming the field, for a camera that can't see.
SplatCamera toCamera(const rosplat_msgs::msg::ViewCamera& message);

}  // namespace rosplat
