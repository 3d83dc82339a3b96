#include "render_service.hpp"

#include <algorithm>
#include <cstring>
#include <rviz_common/frame_manager_iface.hpp>
#include <sensor_msgs/msg/image.hpp>
#include <stdexcept>
#include <utility>
#include <vector>

#include "frames.hpp"
#include "messages.hpp"
#include "rosplat_core/map/printable.hpp"

namespace rosplat {

namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

constexpr auto kAskAgain = 250ms;      // how long a picture waits for an order before it asks again
constexpr double kLongestWait = 60.0;  // for the order of a picture [s]
constexpr auto kSharedWait = 1s;       // the same while other requests wait
constexpr auto kUnserved = 1s;         // without a frame; then requests are refused
constexpr auto kKept = 10s;            // that a view is kept for the next request

sensor_msgs::msg::Image toImage(const std::vector<float>& pixels, const char* encoding,
                                const rosplat_msgs::msg::ViewCamera& camera) {
  sensor_msgs::msg::Image image;
  image.header = camera.header;
  image.width = camera.width;
  image.height = camera.height;
  image.encoding = encoding;
  image.step = static_cast<std::uint32_t>(pixels.size() * sizeof(float) / image.height);
  image.data.resize(pixels.size() * sizeof(float));
  std::memcpy(image.data.data(), pixels.data(), image.data.size());
  return image;
}

}  // namespace

RenderService::RenderService(const std::string& view_id, SplatCloud& cloud, GaussianClient& client,
                             rviz_common::FrameManagerIface& frames)
    : cloud_(cloud), client_(client), frames_(frames), view_(view_id, cloud.scene(), client) {}

void RenderService::serve() {
  served_ = true;
  try {
    if (!request_ && !beginRequest()) {
      if (kept_ && Clock::now() - answered_ > kKept) forget();
      return;
    }
    SplatScene& scene = cloud_.scene();
    const bool wanted = cloud_.settings().order == OrderSource::kSidecar;
    view_.setOrdersWanted(wanted);
    if (wanted) scene.upload(cloud_.settings(), true);
    const bool answered = wanted && scene.answered(view_.id());
    if (wanted && !answered && Clock::now() < deadline()) {
      if (view_.age() > kAskAgain) view_.ask(view_.camera());
      return;
    }
    scene.request(view_.id(), settings(), !answered);
    if (!scene.ready(view_.id(), settings(), !answered)) return;
    auto response = draw(!answered);
    request_->answer(response);
    answered_ = Clock::now();
  } catch (const std::exception& error) {
    request_->refuse(error.what());
    forget();  // a picture that was asked for
  }
  request_.reset();
}

void RenderService::forget() {
  view_.forget();
  kept_ = false;
}

bool RenderService::beginRequest() {
  request_ = client_.takeRenderRequest();
  if (!request_) return false;
  const std::string& detail = request_->request->detail;
  detail_ = detail.empty() ? Detail{} : parseDetail(detail);
  SplatCamera camera = inMapFrame(request_->request->camera);
  camera.extent_scale = extentScale(cloud_.settings());
  view_.ask(camera);
  kept_ = true;
  taken_ = Clock::now();
  const double asked = request_->request->order_timeout;
  const std::chrono::duration<double> wait(asked > 0 ? std::min(asked, kLongestWait) : 0.0);
  deadline_ = taken_ + std::chrono::duration_cast<Clock::duration>(wait);
  return true;
}

Clock::time_point RenderService::deadline() const {
  return client_.renderRequestsWait() ? std::min(deadline_, taken_ + kSharedWait) : deadline_;
}

RenderSettings RenderService::settings() const {
  RenderSettings settings = inFull(cloud_.settings());
  settings.detail = detail_;
  settings.depths = true;
  return settings;
}

SplatCamera RenderService::inMapFrame(rosplat_msgs::msg::ViewCamera camera) const {
  const SplatCamera asked = toCamera(camera);  // throws if a field is invalid, naming it
  geometry_msgs::msg::PoseStamped map, eye;
  map.header.frame_id = client_.frameId();
  eye.header = camera.header;
  eye.pose = camera.pose;
  if (eye.header.frame_id.empty() || eye.header.frame_id == map.header.frame_id) return asked;
  const auto map_pose = inFixedFrame(frames_, map), eye_pose = inFixedFrame(frames_, eye);
  if (!map_pose || !eye_pose) {
    throw std::invalid_argument("camera.header.frame_id: no transform from '" +
                                printable(eye.header.frame_id) + "' to the map");
  }
  camera.pose = *eye_pose;
  return inFrameOf(toPlacement(*map_pose), toCamera(camera));
}

GaussianClient::RenderView::Response RenderService::draw(bool sort_now) {
  GaussianClient::RenderView::Response response;
  SplatScene& scene = cloud_.scene();
  FrameReport report = scene.draw(view_.id(), settings(), Canvas::kNone, sort_now);
  if (!sort_now && !report.order_fresh) {  // the map has changed since the order came
    report = scene.draw(view_.id(), settings(), Canvas::kNone, true);
  }
  const auto& camera = request_->request->camera;
  response.color = toImage(scene.readColor(), "32FC4", camera);
  response.depth = toImage(scene.readDepth(), "32FC1", camera);
  response.splats = report.splats;
  response.error = report.error;
  response.detail_error = report.detail_error;
  response.order_source = report.order_source;
  response.sort_time = report.sort_time;
  response.draw_time = report.draw_time;
  response.map_id = report.map.id;
  response.revision = report.map.revision;
  response.map_complete = report.map.complete();
  response.success = true;
  return response;
}

void RenderService::refuseUnserved() {
  if (std::exchange(served_, false)) {
    unserved_ = Clock::now();
  } else if (Clock::now() - unserved_ > kUnserved) {
    refuse(cloud_.error().empty() ? "rviz draws nothing" : cloud_.error());
  }
}

bool RenderService::refuse(const std::string& why) {
  if (!request_) request_ = client_.takeRenderRequest();
  const bool any = request_.has_value();
  if (any && kept_) forget();
  for (; request_; request_ = client_.takeRenderRequest()) {
    request_->refuse(why);
  }
  return any;
}

}  // namespace rosplat
