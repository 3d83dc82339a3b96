#pragma once

#include <array>
#include <cstddef>
#include <deque>

namespace rosplat {

// One reading. An unknown value is NaN.
struct ImuSample {
  double stamp = 0;  // [s]
  std::array<double, 6>
      axes{};  // linear acceleration x y z [m/s^2], angular velocity x y z [rad/s]
};

// The readings of the last seconds, in order of time.
class ImuHistory {
 public:
  static constexpr std::size_t kCapacity = 60000;  // a minute at 1 kHz
  // A stamp that is earlier by more is a new start (a bag that loops); by less, a late message. [s]
  static constexpr double kJumpBack = 0.5;

  explicit ImuHistory(double window) : window_(window) {}

  void add(const ImuSample& sample);
  void setWindow(double window);
  const std::deque<ImuSample>& samples() const { return samples_; }

 private:
  void trim();

  double window_;  // [s]
  std::deque<ImuSample> samples_;
};

}  // namespace rosplat
