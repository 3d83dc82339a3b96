#pragma once

#include <OgreMaterial.h>

#include <array>
#include <chrono>
#include <deque>
#include <functional>
#include <memory>
#include <rviz_common/interaction/selection_handler.hpp>
#include <set>
#include <string>
#include <vector>

#include "splat_cloud.hpp"

namespace Ogre {
class ManualObject;
class SceneNode;
}  // namespace Ogre

namespace rosplat {

// The slots of a map that rviz's Select tool has selected: outlined in the scene, listed in the
// Selection panel. Its extra handles are tickets, of which each stands for all that has been picked
// at once: which slots that are may be known only later. Make it by createSelectionHandler(), as
// every handler.
class SplatSelection : public rviz_common::interaction::SelectionHandler {
 public:
  // What is known of a selection at most: of more splats than these nothing is shown or told.
  static constexpr std::size_t kOutlined = 2000;
  static constexpr std::size_t kListed = 100;

  // Called with what has been selected anew, kListed splats at most.
  using SelectCallback = std::function<void(const std::vector<SplatValues>&)>;

  // Of the cloud, which hangs on the node; both must outlive the handler.
  SplatSelection(rviz_common::DisplayContext* context, SplatCloud* cloud, Ogre::SceneNode* node,
                 SelectCallback on_select);
  ~SplatSelection() override;

  // Render thread: takes what has been found since, and reads the selected slots again where the
  // map has changed, some times a second. updateProperties() shows it.
  void refresh();
  // Puts the outlines to where the map is now.
  void follow();

  // rviz_common::interaction::SelectionHandler
  bool needsAdditionalRenderPass(std::uint32_t pass) override { return pass < 2; }
  void preRenderPass(std::uint32_t pass) override;
  void postRenderPass(std::uint32_t pass) override;
  void onSelect(const rviz_common::interaction::Picked& picked) override;
  void onDeselect(const rviz_common::interaction::Picked& picked) override;
  void createProperties(const rviz_common::interaction::Picked& picked,
                        rviz_common::properties::Property* parent) override;
  void destroyProperties(const rviz_common::interaction::Picked& picked,
                         rviz_common::properties::Property* parent) override;
  void updateProperties() override;
  rviz_common::interaction::V_AABB getAABBs(
      const rviz_common::interaction::Picked& picked) override;

 private:
  struct Waiting {
    Pick pick;
    bool adds;  // to what is selected, or removes from it
  };

  void begin(bool adds);
  bool take();
  void read();
  void drawOutlines();
  SplatValues outlined(const SplatValues& splat) const;
  void list(rviz_common::properties::Property* parent);

  SplatCloud& cloud_;
  SelectCallback on_select_;
  std::set<std::uint64_t> tickets_;   // selected
  std::deque<Waiting> waiting_;       // picks whose slots aren't known yet
  std::string error_;                 // why those of the last never will be
  std::vector<std::uint32_t> slots_;  // selected, ascending
  std::vector<SplatValues> splats_;   // of the first kOutlined of them
  std::string read_map_;              // as it was when they were read
  std::uint64_t read_revision_ = 0;
  std::chrono::steady_clock::time_point read_at_;
  bool shown_ = true;               // outlines and panel show what was read
  std::array<double, 3> origin_{};  // among them; outlines are relative to it, for Ogre's floats
  Ogre::SceneNode* outline_node_;   // stands there
  std::unique_ptr<Ogre::ManualObject> outlines_;
  Ogre::MaterialPtr material_;
};

}  // namespace rosplat
