#include "view.hpp"

#include <utility>

#include "messages.hpp"

namespace rosplat {

View::View(std::string id, SplatScene& scene, GaussianClient& client)
    : id_(std::move(id)), scene_(scene), client_(client) {}

std::chrono::steady_clock::duration View::age() const {
  return std::chrono::steady_clock::now() - published_;
}

void View::ask(const SplatCamera& camera) {
  camera_ = camera;
  ++sequence_;
  scene_.setCamera(id_, sequence_, camera_);
  publish();
}

void View::look(const SplatCamera& camera) {
  if (sequence_ == 0 || !(camera_ == camera)) ask(camera);
}

void View::forget() {
  scene_.forget(id_);
  client_.forget(id_);
}

void View::setOrdersWanted(bool wanted) {
  const bool begins = wanted && !orders_wanted_ && sequence_ > 0;
  orders_wanted_ = wanted;
  if (begins) publish();
}

void View::publish() {
  published_ = std::chrono::steady_clock::now();
  const auto message = toMessage(camera_, id_, sequence_, client_.header());
  if (orders_wanted_) {
    client_.publish(message);
  } else if (client_.viewsFollowed()) {
    auto unordered = message;
    unordered.sequence = 0;
    client_.publish(unordered);
  }
  if (pose_published_) client_.publishPose(message);
}

}  // namespace rosplat
