#pragma once

#include <OgreAxisAlignedBox.h>
#include <OgreMaterial.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <rviz_common/properties/property.hpp>
#include <string>
#include <vector>

#include "splat_cloud.hpp"

namespace Ogre {
class ManualObject;
class SceneNode;
}  // namespace Ogre

namespace rosplat {

// The slots of a map that are selected: outlined in the scene, described in the Selection panel.
class MapSelection {
 public:
  // The most splats that are outlined, and that are listed and given to SelectCallback.
  static constexpr std::size_t kOutlined = 2000;
  static constexpr std::size_t kListed = 100;

  // Called with the newly selected splats, kListed at most.
  using SelectCallback = std::function<void(const std::vector<SplatValues>&)>;

  // The cloud is attached to the node; both must outlive the selection.
  MapSelection(SplatCloud* cloud, Ogre::SceneNode* node, SelectCallback on_select);
  ~MapSelection();
  MapSelection(const MapSelection&) = delete;
  MapSelection& operator=(const MapSelection&) = delete;

  SplatCloud& cloud() const { return cloud_; }
  // Render thread, as all methods that follow: slots as a Pick gives them.
  void add(Pick::Slots picked);
  void remove(Pick::Slots picked);
  void clear();
  // Reads selected splats again if the map has changed, at most 4 times a second; whether it did.
  bool refresh();
  // Moves the outlines to where the map is now.
  void follow();

  void drawOutlines();
  void setVisible(bool visible);
  std::vector<rviz_common::properties::Property*> describe() const;
  std::vector<Ogre::AxisAlignedBox> boxes() const;

 private:
  void read();
  SplatValues outlined(const SplatValues& splat) const;

  SplatCloud& cloud_;
  SelectCallback on_select_;
  std::vector<std::uint32_t> slots_;  // ascending
  std::vector<SplatValues> splats_;   // values of the first kOutlined slots
  std::string read_map_;              // id of the map when splats_ were read
  std::uint64_t read_begun_ = 0, read_revision_ = 0;
  std::chrono::steady_clock::time_point read_at_;
  std::array<double, 3> origin_{};  // of a splat; outlines are relative to it, for Ogre's floats
  Ogre::SceneNode* outline_node_;   // at origin_
  std::unique_ptr<Ogre::ManualObject> outlines_;
  Ogre::MaterialPtr material_;
};

}  // namespace rosplat
