#include "rosplat_core/order/order_book.hpp"

#include <utility>

namespace rosplat {

namespace {
constexpr std::size_t kRememberedCameras = 64;
}

void OrderBook::setCamera(const std::string& view_id, std::uint64_t sequence,
                          const SplatCamera& camera, double now) {
  ViewOrders& view = views_[view_id];
  view.sequence = sequence;
  if (!view.cameras.empty() && view.cameras.back().camera == camera) return;
  view.cameras.push_back({sequence, camera, now});
  if (view.cameras.size() > kRememberedCameras) view.cameras.pop_front();
}

void OrderBook::mapChanged(const MapState& map) {
  // Another map, or the same map played once more: the revisions begin again.
  const bool begins = map.round != map_.round;
  for (auto& [id, view] : views_) {
    if (begins) view.sidecar = view.built_in = view.drawn = nullptr;
  }
  map_ = map;
  ++changes_;
  for (auto& [id, view] : views_) {
    if (view.early) offer(std::exchange(view.early, nullptr));
  }
}

bool OrderBook::fresh(const ViewOrders& view, const Order& order) const {
  return !view.cameras.empty() && order.sequence >= view.cameras.back().sequence &&
         order.revision == map_.revision && order.map_id == map_.id;
}

bool OrderBook::offer(const OrderPtr& order) {
  const auto found = views_.find(order->view_id);
  if (found == views_.end()) return false;
  ViewOrders& view = found->second;
  if (order->sequence > view.sequence) return false;
  if (order->map_id != map_.id || order->revision > map_.revision) {
    view.early = order;
    return true;
  }
  if (view.sidecar && order->sequence < view.sidecar->sequence) return false;
  // A sidecar that pulls the map anew knows less of the map than before.
  if (view.sidecar && fresh(view, *view.sidecar) && !fresh(view, *order)) return false;
  if (order->bound > map_.capacity || order->slots.size() > map_.capacity) return false;
  view.sidecar = order;
  return true;
}

bool OrderBook::answered(const std::string& view_id) const {
  const auto found = views_.find(view_id);
  return found != views_.end() && found->second.sidecar &&
         fresh(found->second, *found->second.sidecar);
}

void OrderBook::request(const std::string& view_id, ViewOrders& view, const OrderPtr& base) {
  if (view.requested_sequence == view.cameras.back().sequence && view.requested_at == changes_ &&
      view.requested_base == base) {
    return;
  }
  // A merge compares depths, so it needs the camera that the base was sorted for.
  const Camera* camera = nullptr;
  for (const Camera& past : view.cameras) {
    if (base && past.sequence <= base->sequence) camera = &past;
  }
  if (camera) {
    built_in_.request(view_id, base->sequence, camera->camera, base);
  } else {  // there is no base, or its camera is forgotten
    const Camera& newest = view.cameras.back();
    built_in_.request(view_id, newest.sequence, newest.camera, nullptr);
  }
  view.requested_sequence = view.cameras.back().sequence;
  view.requested_at = changes_;
  view.requested_base = base;
}

void OrderBook::takeSorted(const std::string& view_id, ViewOrders& view) {
  OrderPtr sorted = built_in_.take(view_id);
  if (sorted && sorted->map_id == map_.id) view.built_in = std::move(sorted);
}

OrderBook::Choice OrderBook::fromSidecar(const std::string& view_id, double now) {
  ViewOrders& view = views_[view_id];
  if (view.cameras.empty() || !view.sidecar) return {};
  takeSorted(view_id, view);
  if (view.sidecar->revision == map_.revision) {
    view.drawn = view.sidecar;
  } else {
    request(view_id, view, view.sidecar);
    if (view.built_in) view.drawn = view.built_in;
  }
  return chosen(view, view.drawn, now);
}

OrderBook::Choice OrderBook::builtIn(const std::string& view_id, double now) {
  ViewOrders& view = views_[view_id];
  if (view.cameras.empty()) return {};
  takeSorted(view_id, view);
  request(view_id, view, nullptr);
  if (view.built_in) view.drawn = view.built_in;
  return chosen(view, view.drawn, now);
}

OrderBook::Choice OrderBook::received(const std::string& view_id, double now) const {
  const auto found = views_.find(view_id);
  if (found == views_.end()) return {};
  const OrderPtr& order = found->second.sidecar;
  if (!order || order->revision != map_.revision) return {};
  const Choice choice = chosen(found->second, order, now);
  return choice.age > kPatience ? Choice{} : choice;
}

OrderBook::Choice OrderBook::chosen(const ViewOrders& view, const OrderPtr& order,
                                    double now) const {
  Choice choice{order, order && fresh(view, *order), 0};
  if (!order || choice.fresh) return choice;
  // The order is old since the first camera after the one that it answers.
  for (const Camera& camera : view.cameras) {
    if (camera.sequence <= order->sequence) continue;
    choice.age = now - camera.time;
    break;
  }
  return choice;
}

OrderBook::Choice OrderBook::sortNow(const std::string& view_id) {
  ViewOrders& view = views_[view_id];
  if (view.cameras.empty()) return {};
  const Camera& camera = view.cameras.back();
  view.drawn = view.built_in = built_in_.sortNow(view_id, camera.sequence, camera.camera);
  return {view.drawn, true, 0};
}

void OrderBook::forget(const std::string& view_id) {
  views_.erase(view_id);
  built_in_.forget(view_id);
}

}  // namespace rosplat
