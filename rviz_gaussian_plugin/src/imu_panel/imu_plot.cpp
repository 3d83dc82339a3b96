#include "imu_plot.hpp"

#include <QFontDatabase>
#include <algorithm>
#include <cmath>
#include <limits>

namespace rosplat {

namespace {

// rviz's red, green and blue for x, y and z, dark enough for a light background.
const QColor kColors[] = {QColor(214, 48, 49), QColor(34, 153, 84), QColor(41, 111, 209)};
constexpr double kLeastMargin = 0.01;  // around a constant value, in any of the units
const char* const kNames[] = {"x", "y", "z"};

}  // namespace

ImuPlot::ImuPlot(const QString& quantity, std::size_t first) : first_(first) {
  const QColor text = palette().color(QPalette::Text);
  const QColor base = palette().color(QPalette::Base);
  QColor faint = text;
  faint.setAlphaF(0.2);
  setBackground(base);
  for (QCPAxis* axis : {xAxis, yAxis}) {
    for (auto set : {&QCPAxis::setBasePen, &QCPAxis::setTickPen, &QCPAxis::setSubTickPen}) {
      (axis->*set)(QPen(text));
    }
    axis->setTickLabelColor(text);
    axis->setLabelColor(text);
    axis->grid()->setPen(QPen(faint, 0, Qt::DotLine));
    axis->grid()->setZeroLinePen(QPen(faint));
  }
  yAxis->ticker()->setTickCount(3);  // few, because panels are low
  // One plot stands above the other: their axes line up, however wide the labels are.
  axisRect()->setMinimumMargins(QMargins(8 * fontMetrics().averageCharWidth() + 16, 4, 8, 4));

  for (std::size_t i = 0; i < 3; ++i) {
    addGraph()->setPen(QPen(kColors[i]));
    graph()->setName(kNames[i]);
  }
  // The title and the legend stand above the curves, not on them.
  auto* header = new QCPLayoutGrid;
  plotLayout()->insertRow(0);
  plotLayout()->addElement(0, 0, header);
  plotLayout()->setRowSpacing(0);
  auto* title = new QCPTextElement(this, quantity, font());
  title->setTextColor(text);
  header->addElement(0, 0, title);
  header->addElement(0, 1, legend);
  legend->setVisible(true);
  legend->setFillOrder(QCPLegend::foColumnsFirst);  // in a row
  legend->setBrush(Qt::NoBrush);
  legend->setBorderPen(Qt::NoPen);
  legend->setTextColor(text);
  legend->setFont(QFontDatabase::systemFont(QFontDatabase::FixedFont));  // digits stay in place
  legend->setIconSize(10, 8);
  legend->setIconTextPadding(3);
  legend->setMargins(QMargins(0, 0, 0, 0));
  setMinimumHeight(110);
}

void ImuPlot::setUnit(const QString& unit, double scale) {
  yAxis->setLabel(unit);
  scale_ = scale;
}

void ImuPlot::setSamples(const std::vector<ImuSample>& samples, double window) {
  const double now = samples.empty() ? 0 : samples.back().stamp;
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (std::size_t i = 0; i < 3; ++i) {
    QVector<QCPGraphData> data;
    data.reserve(static_cast<int>(samples.size()));
    for (const ImuSample& sample : samples) {
      const double value = scale_ * sample.axes[first_ + i];
      data.append({sample.stamp - now, value});
      low = std::fmin(low, value);  // NaN doesn't count
      high = std::fmax(high, value);
    }
    QCPGraph* graph = this->graph(static_cast<int>(i));
    const double newest =
        data.isEmpty() ? std::numeric_limits<double>::quiet_NaN() : data.last().value;
    graph->setName(QString("%1 %2").arg(kNames[i]).arg(
        std::isnan(newest) ? QString("-") : QString::number(newest, 'f', 3), 8));
    graph->data()->set(data, true);
  }
  xAxis->setRange(-window, 0);
  if (low <= high) {
    const double margin = std::max(0.1 * (high - low), kLeastMargin);
    yAxis->setRange(low - margin, high + margin);
  }
  replot(rpQueuedReplot);
}

}  // namespace rosplat
