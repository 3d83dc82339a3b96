#include "imu_history.hpp"

namespace rosplat {

void ImuHistory::add(const ImuSample& sample) {
  if (!samples_.empty()) {
    const double back = samples_.back().stamp - sample.stamp;
    if (back > kJumpBack) {
      samples_.clear();
    } else if (back > 0) {
      return;
    }
  }
  samples_.push_back(sample);
  trim();
}

void ImuHistory::setWindow(double window) {
  window_ = window;
  trim();
}

void ImuHistory::trim() {
  while (samples_.size() > kCapacity ||
         (!samples_.empty() && samples_.front().stamp < samples_.back().stamp - window_)) {
    samples_.pop_front();
  }
}

}  // namespace rosplat
