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

// Publishes a scene file on a topic: by the topic's publisher, if that can load scenes, else by a
// ply_publisher that it starts and that ends with it. In the first seconds of the process it waits
// for a publisher to appear. Never blocks; status() tells how it goes.
class SceneLoader {
 public:
  SceneLoader(rclcpp::Node::SharedPtr node, std::string topic);
  ~SceneLoader();

  const std::string& topic() const { return topic_; }

  // Takes the place of what is being loaded.
  void load(const std::string& path);
  // Ends what is being loaded, and a publisher that was started here.
  void cancel();

  // A sentence for the user, empty where nothing was asked for.
  const std::string& status();
  bool loading() const { return loading_; }  // as of status()
  bool failed() const { return failed_; }    // as of status()

 private:
  using LoadScene = rosplat_msgs::srv::LoadScene;

  void choosePublisher();
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
