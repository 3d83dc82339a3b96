#pragma once

#include <rosplat_msgs/msg/gaussian_array.hpp>

#include "rosplat_core/map/gaussian_batch.hpp"

namespace rosplat {

// A batch that points into the message, which must outlive it. Nothing is checked yet;
// GaussianMap::apply does that.
GaussianBatch toBatch(const rosplat_msgs::msg::GaussianArray& message, Arrival arrival);

}  // namespace rosplat
