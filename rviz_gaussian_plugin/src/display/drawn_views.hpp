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
  // The last drawn frame of a view.
  struct Report {
    std::string view;  // the view's name in the Status, empty for rviz's main view
    FrameReport frame;
    SplatCamera camera;
  };

  // Scene and client must outlive it. name: of this display, unique among all viewers.
  DrawnViews(std::string name, SplatScene& scene, GaussianClient& client);

  // Before each draw: the view of a viewport. main: rviz's main viewport, not a Camera display's.
  OrderedView& draw(const Ogre::Viewport* viewport, const SplatCamera& camera, bool main,
                    bool orders_wanted, bool publish_pose);
  // Once an update of the display: asks again for orders that don't come, and forgets views that
  // are no longer drawn.
  void update();

  std::vector<Report> reports() const;

 private:
  struct Drawn {
    OrderedView view;
    std::size_t number;
    bool main = false;
    std::chrono::steady_clock::time_point time{};  // when it was last drawn
    int updates = 0;                               // since the last draw
  };

  void forgetUnseen();

  std::string name_;
  SplatScene& scene_;
  GaussianClient& client_;
  std::map<const Ogre::Viewport*, Drawn> views_;
  std::size_t count_ = 0;  // views so far
};

}  // namespace rosplat
