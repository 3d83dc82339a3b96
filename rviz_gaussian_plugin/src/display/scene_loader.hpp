#pragma once

#include <QProcess>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/srv/load_scene.hpp>
#include <string>

namespace rosplat {

// Has a scene file published on a topic: by whoever publishes there already, else by a
// ply_publisher of its own, which ends with the loader. Never blocks; status() tells how it goes.
class SceneLoader {
 public:
  SceneLoader(rclcpp::Node::SharedPtr node, std::string topic)
      : node_(std::move(node)), topic_(std::move(topic)) {}
  ~SceneLoader() { cancel(); }

  const std::string& topic() const { return topic_; }

  void load(const std::string& path);
  // Gives up waiting, and ends a publisher that was started here.
  void cancel();

  // A sentence for the user, empty where nothing was asked for.
  const std::string& status();
  bool failed() const { return failed_; }

 private:
  using LoadScene = rosplat_msgs::srv::LoadScene;

  void startPublisher(const std::string& path);

  rclcpp::Node::SharedPtr node_;
  std::string topic_;
  rclcpp::Client<LoadScene>::SharedPtr client_;
  std::unique_ptr<QProcess> process_;
  std::string status_;
  bool failed_ = false;
};

}  // namespace rosplat
