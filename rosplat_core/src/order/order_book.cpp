#include "rosplat_core/order/order_book.hpp"

#include <algorithm>
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
    if (begins) view.newest = nullptr;
  }
  map_ = map;
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
  if (view.newest && order->sequence < view.newest->sequence) return false;
  // A sidecar that pulls the map anew knows less of the map than before.
  if (view.newest && fresh(view, *view.newest) && !fresh(view, *order)) return false;
  if (order->bound > map_.capacity || order->slots.size() > map_.capacity) return false;
  view.newest = order;
  return true;
}

bool OrderBook::answered(const std::string& view_id) const {
  const auto found = views_.find(view_id);
  return found != views_.end() && found->second.newest &&
         fresh(found->second, *found->second.newest);
}

OrderBook::Choice OrderBook::newest(const std::string& view_id, double now) const {
  const auto found = views_.find(view_id);
  if (found == views_.end()) return {};
  const ViewOrders& view = found->second;
  const OrderPtr& order = view.newest;
  if (!order || order->revision != map_.revision) return {};
  if (fresh(view, *order)) return {order, true, 0};
  // The order is old since the first camera after the one that it answers.
  const auto next = std::find_if(view.cameras.begin(), view.cameras.end(), [&](const auto& camera) {
    return camera.sequence > order->sequence;
  });
  const double age = next == view.cameras.end() ? 0 : now - next->time;
  return age > kPatience ? Choice{} : Choice{order, false, age};
}

}  // namespace rosplat
