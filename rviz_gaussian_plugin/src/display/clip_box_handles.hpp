#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "rosplat_core/views/render_settings.hpp"

namespace Ogre {
class SceneNode;
}
namespace rviz_common {
class DisplayContext;
}
namespace rviz_default_plugins::displays {
class InteractiveMarker;
}

namespace rosplat {

// Handles on a clip box, for rviz's Interact tool: one on each face moves that face, one in the
// middle moves the box. They are rviz's interactive markers, without a server.
class ClipBoxHandles {
 public:
  using DragCallback = std::function<void(const ClipBox& box)>;

  ClipBoxHandles(rviz_common::DisplayContext* context, DragCallback on_drag);
  ~ClipBoxHandles();

  // Call it once a frame: puts the handles on a box in a TF frame, which they follow.
  void show(const ClipBox& box, const std::string& frame_id);

 private:
  // Handles 0 to 5 are the faces, two of each axis, the lower one first.
  static constexpr std::size_t kMiddle = 6;

  void place(std::size_t handle);
  void drag(std::size_t handle, const std::array<float, 3>& to);

  rviz_common::DisplayContext* context_;
  DragCallback on_drag_;
  Ogre::SceneNode* node_;
  ClipBox box_;
  std::string frame_id_;
  std::optional<std::size_t> dragged_;
  std::array<std::unique_ptr<rviz_default_plugins::displays::InteractiveMarker>, kMiddle + 1>
      markers_;
};

}  // namespace rosplat
