#pragma once

#include <chrono>
#include <optional>
#include <string>

#include "gaussian_client.hpp"
#include "ordered_view.hpp"
#include "rosplat_core/levels/detail.hpp"
#include "splat_cloud.hpp"

namespace rviz_common {
class FrameManagerIface;
}

namespace rosplat {

// Draws the pictures that others ask for at <topic>/render, one after the other, its clients in
// turn, each as soon as its order is there, if it takes another's. Render thread only.
class RenderService {
 public:
  // All of them must outlive it; view_id names its view among all viewers'.
  RenderService(const std::string& view_id, SplatCloud& cloud, GaussianClient& client,
                rviz_common::FrameManagerIface& frames);
  ~RenderService() { view_.forget(); }
  RenderService(const RenderService&) = delete;
  RenderService& operator=(const RenderService&) = delete;

  // Once a frame, where the context is current: draws what is due.
  void serve();
  // Once an update of the display: refuses what nobody will draw.
  void refuseUnserved();
  // Refuses all that wait; whether any did.
  bool refuse(const std::string& why);

 private:
  using Clock = std::chrono::steady_clock;

  bool take();
  Clock::time_point deadline() const;
  RenderSettings settings() const;
  SplatCamera inMapFrame(rosplat_msgs::msg::ViewCamera camera) const;
  GaussianClient::RenderView::Response draw(bool sort_now);

  SplatCloud& cloud_;
  GaussianClient& client_;
  rviz_common::FrameManagerIface& frames_;
  OrderedView view_;
  std::optional<GaussianClient::RenderRequest> request_;
  Detail detail_;               // that it asks for
  Clock::time_point taken_;     // when its turn came
  Clock::time_point deadline_;  // of its order, unless others wait
  bool served_ = true;          // since the last update
  Clock::time_point unserved_;  // since when they were not
};

}  // namespace rosplat
