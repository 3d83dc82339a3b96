#include "scene_loader.hpp"

#include <QStringList>
#include <ament_index_cpp/get_package_prefix.hpp>

namespace rosplat {

void SceneLoader::load(const std::string& path) {
  cancel();
  failed_ = false;
  const auto publishers = node_->get_publishers_info_by_topic(topic_);
  for (const auto& publisher : publishers) {
    std::string name = publisher.node_namespace();
    if (name.back() != '/') name += '/';
    name += publisher.node_name() + "/load";
    client_ = node_->create_client<LoadScene>(name);
    if (!client_->service_is_ready()) continue;  // a SLAM node, say
    auto request = std::make_shared<LoadScene::Request>();
    request->path = path;
    status_ = "loading " + path;
    client_->async_send_request(request, [this](rclcpp::Client<LoadScene>::SharedFuture future) {
      const auto response = future.get();
      status_ = response->message;
      failed_ = !response->success;
    });
    return;
  }
  client_.reset();
  if (!publishers.empty()) {
    status_ = "the publisher of " + topic_ + " has no service to load scenes; choose another topic";
    failed_ = true;
    return;
  }
  startPublisher(path);
}

void SceneLoader::startPublisher(const std::string& path) {
  try {
    const std::string program =
        ament_index_cpp::get_package_prefix("rosplat_tools") + "/lib/rosplat_tools/ply_publisher";
    process_ = std::make_unique<QProcess>();
    process_->setProcessChannelMode(QProcess::MergedChannels);
    process_->start(QString::fromStdString(program),
                    {"--ros-args", "-p", QString::fromStdString("path:=" + path), "-r",
                     QString::fromStdString("gaussians:=" + topic_)});
    status_ = "loading " + path + " by a publisher of this display";
  } catch (const ament_index_cpp::PackageNotFoundError&) {
    status_ = "rosplat_tools is not installed: nothing can publish " + path;
    failed_ = true;
  }
}

void SceneLoader::cancel() {
  if (client_) {
    client_.reset();  // an answer goes to nobody
    status_ = "cancelled";
  }
  if (process_) {
    process_->terminate();
    if (!process_->waitForFinished(1000)) process_->kill();
    process_->waitForFinished(1000);
    process_.reset();
    status_ = "cancelled";
  }
}

const std::string& SceneLoader::status() {
  if (process_ && !failed_ && process_->state() == QProcess::NotRunning) {
    // Its last line is the reason.
    const QStringList lines =
        QString::fromUtf8(process_->readAll()).split('\n', Qt::SkipEmptyParts);
    failed_ = true;
    status_ = lines.isEmpty() ? "the publisher ended" : lines.last().toStdString();
  }
  return status_;
}

}  // namespace rosplat
