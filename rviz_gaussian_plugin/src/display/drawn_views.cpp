#include "drawn_views.hpp"

#include <utility>

namespace rosplat {

namespace {

using namespace std::chrono_literals;

// A view's camera goes out at least this often, so that a sorter that starts late learns of it.
constexpr auto kKeepAlive = 1s;
constexpr auto kUnseen = 2s;  // a view that isn't drawn for longer is forgotten

}  // namespace

DrawnViews::DrawnViews(std::string name, SplatScene& scene, GaussianClient& client)
    : name_(std::move(name)), scene_(scene), client_(client) {}

OrderedView& DrawnViews::draw(const Ogre::Viewport* viewport, const SplatCamera& camera, bool main,
                              bool orders_wanted, bool publish_pose) {
  auto found = views_.find(viewport);
  if (found == views_.end()) {
    const std::size_t number = ++count_;
    OrderedView view(name_ + "/" + std::to_string(number), scene_, client_);
    found = views_.emplace(viewport, Drawn{std::move(view), number}).first;
  }
  Drawn& drawn = found->second;
  drawn.main = main;
  drawn.time = std::chrono::steady_clock::now();
  drawn.updates = 0;
  drawn.view.setPosePublished(main && publish_pose);
  // A sidecar's order covers one map only, so none is wanted for a picture of several maps.
  drawn.view.setOrdersWanted(orders_wanted && scene_.report(drawn.view.id()).maps == 1);
  drawn.view.askIfChanged(camera);
  return drawn.view;
}

void DrawnViews::update() {
  forgetUnseen();
  for (auto& [viewport, drawn] : views_) {
    OrderedView& view = drawn.view;
    if (view.age() < kKeepAlive) continue;
    const FrameReport report = scene_.report(view.id());
    if (report.order_fresh && report.order_source.rfind("sidecar", 0) == 0) {
      view.publish();
    } else {  // during discovery, a view or an order may have been lost
      view.ask(view.camera());
    }
  }
}

void DrawnViews::forgetUnseen() {
  for (auto drawn = views_.begin(); drawn != views_.end();) {
    const bool by_a_slow_frame = ++drawn->second.updates == 1;
    if (by_a_slow_frame || std::chrono::steady_clock::now() - drawn->second.time < kUnseen) {
      ++drawn;
    } else {
      drawn->second.view.forget();
      drawn = views_.erase(drawn);
    }
  }
}

std::vector<DrawnViews::Report> DrawnViews::reports() const {
  std::vector<Report> reports;
  for (const auto& [viewport, drawn] : views_) {
    reports.push_back({drawn.main ? "" : "view " + std::to_string(drawn.number),
                       scene_.report(drawn.view.id()), drawn.view.camera()});
  }
  return reports;
}

}  // namespace rosplat
