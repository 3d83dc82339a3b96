#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include "gaussian_client.hpp"
#include "splat_scene.hpp"

namespace rosplat {

// A view of the map that asks for its orders. Each of its cameras goes to the scene and, if orders
// are wanted, to sidecars, with a sequence number that the orders repeat. Other followers of views
// get each camera in any case. Render thread only.
class OrderedView {
 public:
  // Scene and client must outlive it.
  OrderedView(std::string id, SplatScene& scene, GaussianClient& client);

  const std::string& id() const { return id_; }
  const SplatCamera& camera() const { return camera_; }
  std::chrono::steady_clock::duration age() const;  // since the camera was published

  // Asks for an order of this camera.
  void ask(const SplatCamera& camera);
  // The same, unless this camera was asked for last.
  void askIfChanged(const SplatCamera& camera);
  // Ends the view: scene and client forget it.
  void forget();
  // Publishes the camera again, for sidecars that start late.
  void publish();
  // Whether sidecars are asked at all, from now on.
  void setOrdersWanted(bool wanted);
  // Whether the camera's pose and path are published, too.
  void setPosePublished(bool published) { pose_published_ = published; }

 private:
  std::string id_;
  SplatScene& scene_;
  GaussianClient& client_;
  std::uint64_t sequence_ = 0;
  SplatCamera camera_;
  std::chrono::steady_clock::time_point published_;
  bool orders_wanted_ = false;
  bool pose_published_ = false;
};

}  // namespace rosplat
