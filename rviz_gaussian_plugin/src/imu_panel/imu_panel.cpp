#include "imu_panel.hpp"

#include <QComboBox>
#include <QDoubleSpinBox>
#include <QHBoxLayout>
#include <QLabel>
#include <QLineEdit>
#include <QTimer>
#include <QToolButton>
#include <QVBoxLayout>
#include <algorithm>
#include <exception>
#include <functional>
#include <pluginlib/class_list_macros.hpp>
#include <rviz_common/display_context.hpp>
#include <rviz_common/ros_integration/ros_node_abstraction_iface.hpp>
#include <utility>

#include "imu_plot.hpp"

namespace rosplat {

namespace {

constexpr int kRedrawPeriod = 50;               // [ms]
constexpr int kSilence = 1000;                  // [ms] without a message until the status says so
constexpr double kStandardGravity = 9.80665;    // [m/s^2]
constexpr double kDegrees = 57.29577951308232;  // degrees in a radian

// A combo box that asks for its entries each time it opens: topics come and go.
class TopicBox : public QComboBox {
 public:
  using List = std::function<QStringList()>;

  explicit TopicBox(List list) : list_(std::move(list)) {
    setEditable(true);
    setInsertPolicy(QComboBox::NoInsert);
    setSizeAdjustPolicy(QComboBox::AdjustToMinimumContentsLengthWithIcon);
    setMinimumContentsLength(12);
  }

  void showPopup() override {
    const QString text = currentText();
    clear();
    addItems(list_());
    setCurrentIndex(findText(text));
    setEditText(text);
    QComboBox::showPopup();
  }

 private:
  List list_;
};

QStringList imuTopics(const rclcpp::Node& node) {
  QStringList topics;
  for (const auto& [name, types] : node.get_topic_names_and_types()) {
    if (std::find(types.begin(), types.end(), "sensor_msgs/msg/Imu") != types.end()) {
      topics.append(QString::fromStdString(name));
    }
  }
  return topics;
}

QComboBox* unitBox(const QString& si, double si_scale, const QString& other, double other_scale) {
  auto* box = new QComboBox;
  box->addItem(si, si_scale);
  box->addItem(other, other_scale);
  return box;
}

}  // namespace

ImuPanel::ImuPanel(QWidget* parent) : Panel(parent) {
  topic_box_ = new TopicBox([this] { return node_ ? imuTopics(*node_) : QStringList(); });
  topic_box_->lineEdit()->setPlaceholderText("topic of type sensor_msgs/Imu");
  topic_box_->setToolTip("Topic of type sensor_msgs/Imu to plot.");
  pause_ = new QToolButton;
  pause_->setText("Pause");
  pause_->setCheckable(true);
  pause_->setToolTip("Hold the plots still. Drag and wheel then move and zoom them.");
  window_ = new QDoubleSpinBox;
  window_->setRange(1, 60);
  window_->setDecimals(1);
  window_->setValue(10);
  window_->setSuffix(" s");
  window_->setKeyboardTracking(false);
  window_->setToolTip("Time that the plots show.");
  acceleration_unit_ = unitBox("m/s²", 1, "g", 1 / kStandardGravity);
  acceleration_unit_->setToolTip("Unit of linear acceleration.");
  rate_unit_ = unitBox("rad/s", 1, "deg/s", kDegrees);
  rate_unit_->setToolTip("Unit of angular velocity.");
  acceleration_plot_ = new ImuPlot("Acceleration", 0);
  rate_plot_ = new ImuPlot("Angular velocity", 3);
  rate_plot_->xAxis->setLabel("Time [s]");
  status_ = new QLabel;
  status_->setWordWrap(true);
  status_->setSizePolicy(QSizePolicy::Ignored, QSizePolicy::Preferred);  // no text widens the panel

  auto* source = new QHBoxLayout;
  source->addWidget(topic_box_, 1);
  source->addWidget(pause_);
  auto* view = new QHBoxLayout;
  view->addWidget(window_);
  view->addWidget(acceleration_unit_);
  view->addWidget(rate_unit_);
  view->addStretch();
  auto* layout = new QVBoxLayout(this);
  layout->addLayout(source);
  layout->addLayout(view);
  layout->addWidget(acceleration_plot_, 1);
  layout->addWidget(rate_plot_, 1);
  layout->addWidget(status_);

  connect(topic_box_, &QComboBox::textActivated, this, &ImuPanel::setTopic);
  connect(topic_box_->lineEdit(), &QLineEdit::editingFinished, this,
          [this] { setTopic(topic_box_->currentText()); });
  connect(pause_, &QToolButton::toggled, this, &ImuPanel::applyPause);
  connect(window_, QOverload<double>::of(&QDoubleSpinBox::valueChanged), this,
          &ImuPanel::applyWindow);
  for (QComboBox* box : {acceleration_unit_, rate_unit_}) {
    connect(box, QOverload<int>::of(&QComboBox::currentIndexChanged), this, &ImuPanel::applyUnits);
  }
  auto* timer = new QTimer(this);
  connect(timer, &QTimer::timeout, this, &ImuPanel::refresh);
  timer->start(kRedrawPeriod);
  applyUnits();
}

ImuPanel::~ImuPanel() = default;

void ImuPanel::onInitialize() {
  node_ = getDisplayContext()->getRosNodeAbstraction().lock()->get_raw_node();
}

void ImuPanel::load(const rviz_common::Config& config) {
  Panel::load(config);
  QString text;
  float window;
  if (config.mapGetString("Acceleration Unit", &text)) acceleration_unit_->setCurrentText(text);
  if (config.mapGetString("Angular Velocity Unit", &text)) rate_unit_->setCurrentText(text);
  if (config.mapGetFloat("Window", &window)) window_->setValue(window);
  if (config.mapGetString("Topic", &text)) setTopic(text);
}

void ImuPanel::save(rviz_common::Config config) const {
  Panel::save(config);
  config.mapSetValue("Topic", topic_);
  config.mapSetValue("Window", window_->value());
  config.mapSetValue("Acceleration Unit", acceleration_unit_->currentText());
  config.mapSetValue("Angular Velocity Unit", rate_unit_->currentText());
}

void ImuPanel::setTopic(const QString& text) {
  const QString topic = text.trimmed();
  if (topic == topic_) return;
  topic_ = topic;
  topic_box_->setEditText(topic_);
  receiver_.reset();
  refusal_.clear();
  shown_ = {};
  since_new_.start();
  pause_->setChecked(false);
  if (!topic_.isEmpty()) {
    try {
      receiver_ = std::make_unique<ImuReceiver>(node_, topic_.toStdString(), window_->value());
    } catch (const std::exception& error) {
      refusal_ = QString("Can't subscribe: %1").arg(error.what());
    }
  }
  draw();
  Q_EMIT configChanged();
}

void ImuPanel::applyWindow() {
  if (receiver_) receiver_->setWindow(window_->value());
  draw();
  Q_EMIT configChanged();
}

void ImuPanel::applyUnits() {
  acceleration_plot_->setUnit(acceleration_unit_->currentText(),
                              acceleration_unit_->currentData().toDouble());
  rate_plot_->setUnit(rate_unit_->currentText(), rate_unit_->currentData().toDouble());
  draw();
  Q_EMIT configChanged();
}

void ImuPanel::applyPause() {
  for (ImuPlot* plot : {acceleration_plot_, rate_plot_}) {
    plot->setInteractions(pause_->isChecked() ? QCP::iRangeDrag | QCP::iRangeZoom
                                              : QCP::Interactions());
  }
  refresh();
}

void ImuPanel::refresh() {
  if (receiver_ && isVisible() && !pause_->isChecked() &&
      receiver_->received() != shown_.received) {
    shown_ = receiver_->snapshot();
    since_new_.start();
    draw();
  }
  status_->setText(status());
}

void ImuPanel::draw() {
  for (ImuPlot* plot : {acceleration_plot_, rate_plot_}) {
    plot->setSamples(shown_.samples, window_->value());
  }
}

QString ImuPanel::status() const {
  if (!refusal_.isEmpty()) return refusal_;
  if (!receiver_) return "Choose a topic of type sensor_msgs/Imu.";
  if (pause_->isChecked()) return "Paused.";
  if (shown_.received == 0) return QString("Waiting for messages on %1.").arg(topic_);
  if (since_new_.elapsed() > kSilence) return QString("No new messages on %1.").arg(topic_);
  const double span = shown_.samples.back().stamp - shown_.samples.front().stamp;
  if (shown_.samples.size() > 1 && span <= 0) {
    return QString("Messages on %1 all carry the same header.stamp: no time to plot over.")
        .arg(topic_);
  }
  const double rate = span > 0 ? static_cast<double>(shown_.samples.size() - 1) / span : 0;
  return QString("%1 Hz in frame %2.")
      .arg(rate, 0, 'f', 0)
      .arg(QString::fromStdString(shown_.frame_id));
}

}  // namespace rosplat

PLUGINLIB_EXPORT_CLASS(rosplat::ImuPanel, rviz_common::Panel)
