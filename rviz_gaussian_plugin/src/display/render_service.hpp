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

// Draws the pictures that clients ask for at <topic>/render, one after the other, clients in turn.
// A picture that takes a sidecar's order waits for that. Render thread only.
class RenderService {
 public:
  // All arguments must outlive it. view_id: unique among all viewers' views.
  RenderService(const std::string& view_id, SplatCloud& cloud, GaussianClient& client,
                rviz_common::FrameManagerIface& frames);
  ~RenderService() { view_.forget(); }
  RenderService(const RenderService&) = delete;
  RenderService& operator=(const RenderService&) = delete;

  // Once a frame, with the OpenGL context current: draws the picture that is due.
  void serve();
  // Once an update of the display: refuses all requests once rviz has drawn nothing for a second.
  void refuseUnserved();
  // Refuses all waiting requests. Returns whether there were any.
  bool refuse(const std::string& why);

 private:
  using Clock = std::chrono::steady_clock;

  bool beginRequest();
  // Lets go of the view: of its picture, and of levels that nobody else draws.
  void forget();
  Clock::time_point deadline() const;
  RenderSettings settings() const;
  SplatCamera inMapFrame(rosplat_msgs::msg::ViewCamera camera) const;
  GaussianClient::RenderView::Response draw(bool sort_now);

  SplatCloud& cloud_;
  GaussianClient& client_;
  rviz_common::FrameManagerIface& frames_;
  OrderedView view_;
  std::optional<GaussianClient::RenderRequest> request_;
  Detail detail_;               // that request_ asks for
  Clock::time_point taken_;     // when the request's turn came
  Clock::time_point answered_;  // when the last one was answered
  Clock::time_point deadline_;  // of its order, unless others wait
  bool kept_ = false;           // the scene knows view_
  bool served_ = true;          // serve() was called since the last update
  Clock::time_point unserved_;  // last update that found served_
};

}  // namespace rosplat
