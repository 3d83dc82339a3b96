#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "ordered_view.hpp"

namespace Ogre {
class Viewport;
}

namespace rosplat {

// The viewports that a map is drawn in, a view for each. Render thread only.
class DrawnViews {
 public:
  // What was drawn last of a view.
  struct Report {
    std::string view;  // what the Status calls it, empty for rviz's own
    FrameReport frame;
    SplatCamera camera;
  };

  // Scene and client must outlive it; the name is this display's alone among all viewers'.
  DrawnViews(std::string name, SplatScene& scene, GaussianClient& client);

  // Before each draw: the view of a viewport. main: it is rviz's own, not a Camera display's, say.
  OrderedView& draw(const Ogre::Viewport* viewport, const SplatCamera& camera, bool main,
                    bool orders_wanted, bool publish_pose);
  // Once an update of the display: asks again for orders that don't come, and forgets views that
  // aren't drawn any more.
  void update();

  std::vector<Report> reports() const;

 private:
  struct Drawn {
    OrderedView view;
    std::size_t number;
    bool main = false;
    std::chrono::steady_clock::time_point time{};  // when it was last drawn
    int updates = 0;                               // since then
  };

  void forgetUnseen();

  std::string name_;
  SplatScene& scene_;
  GaussianClient& client_;
  std::map<const Ogre::Viewport*, Drawn> views_;
  std::size_t count_ = 0;  // that there ever were
};

}  // namespace rosplat
