#pragma once

#include <algorithm>
#include <cmath>
#include <optional>

namespace rosplat {

// How long to wait for an answer before the question is asked again: TCP's retransmission timer
// (RFC 6298). It follows what answers take, their mean and four mean deviations, and doubles with
// each question in vain, until an answer comes. [s]
class Patience {
 public:
  static constexpr double kAtFirst = 2.0;  // while no answer is known
  static constexpr double kLeast = 1.0;
  static constexpr double kMost = 8.0;  // by doubling alone

  double wait() const { return wait_; }

  void learn(double took) {
    if (mean_) {
      deviation_ += (std::abs(took - *mean_) - deviation_) / 4;
      *mean_ += (took - *mean_) / 8;
    } else {
      mean_ = took;
      deviation_ = took / 2;
    }
    usual_ = std::max(kLeast, *mean_ + 4 * deviation_);
    wait_ = usual_;
  }

  void doubleUp() { wait_ = std::min(2 * wait_, std::max(kMost, usual_)); }

 private:
  std::optional<double> mean_;
  double deviation_ = 0;
  double usual_ = kAtFirst, wait_ = kAtFirst;
};

}  // namespace rosplat
