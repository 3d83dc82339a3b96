#include "scene_loader.hpp"

#include <QStringList>
#include <QUuid>
#include <algorithm>
#include <ament_index_cpp/get_package_prefix.hpp>
#include <exception>
#include <set>

#include "ros_graph.hpp"
#include "rosplat_ros/ros_versions.hpp"

namespace rosplat {

namespace {
using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

constexpr int kGrace = 3000;      // what a publisher gets to end by itself [ms]
constexpr auto kDiscovery = 5s;   // until nodes that start together know each other
constexpr auto kMeeting = 500ms;  // until a new client knows its service
constexpr auto kLookAgain = 100ms;

// Resolved topics of the publishers that displays of this process have started.
std::multiset<std::string>& startedTopics() {
  static std::multiset<std::string> topics;
  return topics;
}

// The frame of a scene as its file has it, one for each topic; view.launch.py names its so, too.
std::string frameOf(const std::string& topic) {
  return topic == "/gaussians" ? "scene" : topic.substr(1) + "/scene";
}

// Quotes a parameter's value for the command line, which ROS reads as YAML.
QString quoted(const std::string& text) {
  return "'" + QString::fromStdString(text).replace("'", "''") + "'";
}
}  // namespace

SceneLoader::SceneLoader(rclcpp::Node::SharedPtr node, std::string topic)
    : node_(std::move(node)), topic_(std::move(topic)) {
  static const Clock::time_point all_known = Clock::now() + kDiscovery;
  choice_ends_ = all_known;
  QObject::connect(&choice_, &QTimer::timeout, &choice_, [this] { choosePublisher(); });
}

SceneLoader::~SceneLoader() {
  stopPublisher();
  client_.reset();
  endChoice();
}

void SceneLoader::load(const std::string& path) {
  path_ = path;
  status_ = "looking for a publisher of " + topic_;
  loading_ = true;
  failed_ = false;
  choice_ends_ = std::max(choice_ends_, Clock::now() + kMeeting);
  choice_.start(kLookAgain);
  choosePublisher();
}

void SceneLoader::choosePublisher() {
  try {
    lookForPublisher();
  } catch (const std::exception& error) {
    if (!node_->get_node_base_interface()->get_context()->is_valid()) return;  // ROS has ended
    endChoice();
    report(error.what(), true);
  }
}

void SceneLoader::lookForPublisher() {
  const auto publishers = node_->get_publishers_info_by_topic(topic_);
  for (const auto& publisher : publishers) {
    const std::string name = nodeOf(publisher);
    if (name.empty()) continue;
    auto& candidate = candidates_[name];
    if (!candidate) candidate = node_->create_client<LoadScene>(name + "/load");
    if (!candidate->service_is_ready()) continue;  // a SLAM node, say
    client_ = candidate;
    endChoice();
    status_ = "loading " + path_;
    request(path_);
    return;
  }
  if (Clock::now() < choice_ends_) return;
  client_.reset();
  endChoice();
  const bool runs = process_ && process_->state() != QProcess::NotRunning;
  if (!runs && startedTopics().count(resolvedTopic())) {  // another display's, soon ready
    choice_ends_ = Clock::now() + kMeeting;
    choice_.start(kLookAgain);
  } else if (process_ || publishers.empty()) {  // one started here may not have a service yet
    stopPublisher();
    startPublisher(path_);
  } else {
    report("the publisher of " + topic_ + " has no service to load scenes; choose another topic",
           true);
  }
}

std::string SceneLoader::resolvedTopic() const {
  return node_->get_node_topics_interface()->resolve_topic_name(topic_);
}

void SceneLoader::endChoice() {
  choice_.stop();
  candidates_.clear();
  collectEntities(*node_->get_node_base_interface()->get_default_callback_group());
}

void SceneLoader::request(const std::string& path) {
  auto request = std::make_shared<LoadScene::Request>();
  request->path = path;
  client_->async_send_request(request,
                              [this, path](rclcpp::Client<LoadScene>::SharedFuture future) {
                                if (!loading_ || path != path_) return;  // cancelled since
                                const auto response = future.get();
                                report(response->message, !response->success);
                              });
}

void SceneLoader::startPublisher(const std::string& path) {
  try {
    const std::string program =
        ament_index_cpp::get_package_prefix("rosplat_tools") + "/lib/rosplat_tools/ply_publisher";
    const std::string topic = resolvedTopic();
    process_ = std::make_unique<QProcess>();
    const auto started = startedTopics().insert(topic);
    QObject::connect(process_.get(), &QProcess::stateChanged, [started](QProcess::ProcessState to) {
      if (to == QProcess::NotRunning) startedTopics().erase(started);
    });
    process_->setProcessChannelMode(QProcess::MergedChannels);
    // A node name of its own, or other displays' publishers would have the same service; and the
    // topic as rviz2 resolves it, which may have a namespace and remappings.
    const QString id = QUuid::createUuid().toString(QUuid::Id128).left(8);
    process_->start("setpriv",  // the publisher ends with rviz2, even if that crashes
                    {"--pdeathsig", "TERM", QString::fromStdString(program), "--ros-args", "-p",
                     "path:=" + quoted(path), "-p", "frame_id:=" + quoted(frameOf(topic)), "-p",
                     "upright_frame:=map", "-r", "__node:=ply_publisher_" + id, "-r",
                     QString::fromStdString("gaussians:=" + topic)});
    status_ = "loading " + path;
  } catch (const ament_index_cpp::PackageNotFoundError&) {
    report("rosplat_tools is not installed: nothing can publish " + path, true);
  }
}

void SceneLoader::stopPublisher() {
  if (!process_) return;
  QProcess* process = process_.release();  // it ends on its own time
  if (process->state() == QProcess::NotRunning) {
    process->deleteLater();
    return;
  }
  QObject::connect(process, QOverload<int, QProcess::ExitStatus>::of(&QProcess::finished), process,
                   &QObject::deleteLater);
  QTimer::singleShot(kGrace, process, &QProcess::kill);
  process->terminate();
}

void SceneLoader::cancel() {
  const bool choosing = choice_.isActive();
  endChoice();
  if (process_ || choosing) {
    stopPublisher();
    report("cancelled", false);
  } else if (loading_ && client_) {
    request("");
    report("cancelled", false);
  } else {
    report("", false);  // nothing more to say
  }
}

void SceneLoader::report(const std::string& text, bool failed) {
  status_ = text;
  failed_ = failed;
  loading_ = false;
}

void SceneLoader::readPublisher() {
  const QStringList lines = QString::fromUtf8(process_->readAll()).split('\n', Qt::SkipEmptyParts);
  const bool ended = process_->state() == QProcess::NotRunning;
  if (!lines.isEmpty()) {
    // Without the prefix of a line of ROS's log: "[INFO] [time] [name]: ".
    const int text = lines.last().lastIndexOf("]: ");
    status_ = lines.last().mid(text < 0 ? 0 : text + 3).toStdString();
    // The result begins with the path. If the process has ended, the last line is the reason.
    if (status_.rfind(path_ + ":", 0) == 0) report(status_, ended);
  }
  if (!ended || failed_) return;
  if (process_->error() == QProcess::FailedToStart) {
    report(process_->errorString().toStdString(), true);
  } else {
    report(loading_ ? status_ : "the publisher of " + path_ + " has ended", true);
  }
}

const std::string& SceneLoader::status() {
  const bool lacking = (loading_ || failed_) && client_ && !choice_.isActive();
  if (lacking && !client_->service_is_ready()) load(path_);  // the publisher is gone: asks another
  if (process_ && !failed_ && !choice_.isActive()) readPublisher();
  return status_;
}

}  // namespace rosplat
