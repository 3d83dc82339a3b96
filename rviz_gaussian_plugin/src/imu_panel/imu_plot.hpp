#pragma once

#include <qcustomplot.h>

#include <cstddef>
#include <vector>

#include "imu_history.hpp"

namespace rosplat {

// The x, y and z of one quantity over the last seconds, with the newest values in the legend.
class ImuPlot : public QCustomPlot {
 public:
  // Plots the axes first to first + 2 of a sample.
  ImuPlot(const QString& quantity, std::size_t first);

  void setUnit(const QString& unit, double scale);  // scale: units in one SI unit
  void setSamples(const std::vector<ImuSample>& samples, double window);

 private:
  std::size_t first_;
  double scale_ = 1;
};

}  // namespace rosplat
