#pragma once

#include <QProcess>
#include <QTimer>
#include <chrono>
#include <map>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <rosplat_msgs/srv/load_scene.hpp>
#include <string>

namespace rosplat {

// Publishes a scene file on a topic: by the topic's publisher, which must be able to load scenes,
// or without one by a ply_publisher that the loader starts and ends, which stands the scene upright
// in the frame `map`, as view.launch.py's does. In the first seconds of the process the loader
// waits for a publisher to appear. Never blocks; status() tells how it goes.
class SceneLoader {
 public:
  SceneLoader(rclcpp::Node::SharedPtr node, std::string topic);
  ~SceneLoader();

  const std::string& topic() const { return topic_; }

  // Loads a file, in place of one that is being loaded.
  void load(const std::string& path);
  // Cancels a load, and ends a publisher that was started here.
  void cancel();

  // A sentence for the user, empty if no file was asked for.
  const std::string& status();
  bool loading() const { return loading_; }  // as of status()
  bool failed() const { return failed_; }    // as of status()

 private:
  using LoadScene = rosplat_msgs::srv::LoadScene;

  void choosePublisher();
  void lookForPublisher();
  std::string resolvedTopic() const;
  void endChoice();
  void request(const std::string& path);
  void startPublisher(const std::string& path);
  void stopPublisher();
  void readPublisher();
  void report(const std::string& text, bool failed);

  rclcpp::Node::SharedPtr node_;
  std::string topic_;
  std::map<std::string, rclcpp::Client<LoadScene>::SharedPtr> candidates_;  // by name
  QTimer choice_;  // runs while none of them is ready
  std::chrono::steady_clock::time_point choice_ends_;
  rclcpp::Client<LoadScene>::SharedPtr client_;
  std::unique_ptr<QProcess> process_;
  std::string path_;
  std::string status_;
  bool loading_ = false;
  bool failed_ = false;
};

}  // namespace rosplat
