#include "ordered_view.hpp"

#include <utility>

#include "messages.hpp"

namespace rosplat {

OrderedView::OrderedView(std::string id, SplatScene& scene, GaussianClient& client)
    : id_(std::move(id)), scene_(scene), client_(client) {}

std::chrono::steady_clock::duration OrderedView::age() const {
  return std::chrono::steady_clock::now() - published_;
}

void OrderedView::ask(const SplatCamera& camera) {
  camera_ = camera;
  ++sequence_;
  scene_.setCamera(id_, sequence_, camera_);
  publish();
}

void OrderedView::askIfChanged(const SplatCamera& camera) {
  if (sequence_ == 0 || !(camera_ == camera)) ask(camera);
}

void OrderedView::forget() {
  scene_.forget(id_);
  client_.forget(id_);
}

void OrderedView::setOrdersWanted(bool wanted) {
  const bool begins = wanted && !orders_wanted_ && sequence_ > 0;
  if (!wanted && orders_wanted_) client_.forget(id_);
  orders_wanted_ = wanted;
  if (begins) publish();
}

void OrderedView::publish() {
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
