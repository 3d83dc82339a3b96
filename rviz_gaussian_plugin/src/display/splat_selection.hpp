#pragma once

#include <deque>
#include <memory>
#include <rviz_common/interaction/selection_handler.hpp>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "map_selection.hpp"

namespace rosplat {

// The splats that rviz's Select tool has selected. One handler serves all maps, since it may be
// known only later which map a pixel shows. Its extra handles are tickets: each stands for all
// splats of one pick.
class SplatSelection : public rviz_common::interaction::SelectionHandler {
 public:
  // The instance that the displays of a process share.
  static std::shared_ptr<SplatSelection> ofProcess(rviz_common::DisplayContext* context);
  // Made by createSelectionHandler(), as every handler.
  explicit SplatSelection(rviz_common::DisplayContext* context) : SelectionHandler(context) {}

  // Adds a cloud, attached to the node, for as long as the result is held; both must outlive that.
  std::shared_ptr<MapSelection> of(SplatCloud* cloud, Ogre::SceneNode* node,
                                   MapSelection::SelectCallback on_select);

  // Render thread: takes the picks found since the last call, and reads selected splats again if
  // their map has changed. updateProperties() shows the result.
  void refresh();

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
    std::vector<std::pair<SplatCloud*, Pick>> picks;
    bool adds;  // to the selection; else removes from it

    bool found() const;
  };

  void removeMap(MapSelection* map);
  void begin(bool adds);
  bool applyFound();
  void apply(Waiting& found);
  void drawOutlines();
  void list(rviz_common::properties::Property* parent);

  std::vector<MapSelection*> maps_;
  std::set<std::uint64_t> tickets_;  // selected
  std::deque<Waiting> waiting_;      // picks whose slots aren't known yet
  std::string error_;                // why the last pick's slots never will be known
  bool shown_ = true;                // outlines and panel are up to date
};

}  // namespace rosplat
