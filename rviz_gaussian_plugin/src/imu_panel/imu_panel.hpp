#pragma once

#include <QElapsedTimer>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rviz_common/panel.hpp>

#include "imu_receiver.hpp"

class QComboBox;
class QDoubleSpinBox;
class QLabel;
class QToolButton;

namespace rosplat {

class ImuPlot;

// Plots the six axes of an IMU over the last seconds.
class ImuPanel : public rviz_common::Panel {
  Q_OBJECT

 public:
  explicit ImuPanel(QWidget* parent = nullptr);
  ~ImuPanel() override;

  void onInitialize() override;
  void load(const rviz_common::Config& config) override;
  void save(rviz_common::Config config) const override;

 private:
  void setTopic(const QString& topic);
  void applyWindow();
  void applyUnits();
  void applyPause();
  void refresh();
  void draw();
  QString status() const;

  QComboBox* topic_box_;
  QToolButton* pause_;
  QDoubleSpinBox* window_;
  QComboBox* acceleration_unit_;
  QComboBox* rate_unit_;
  ImuPlot* acceleration_plot_;
  ImuPlot* rate_plot_;
  QLabel* status_;

  rclcpp::Node::SharedPtr node_;
  QString topic_;
  QString refusal_;  // why there is no receiver for the topic
  std::unique_ptr<ImuReceiver> receiver_;
  ImuReceiver::Snapshot shown_;
  QElapsedTimer since_new_;
};

}  // namespace rosplat
