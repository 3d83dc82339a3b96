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

// What rviz's Select tool has selected, of all maps, since which of them a pixel shows may be known
// only later. Its extra handles are tickets, of which each stands for all that has been picked at
// once.
class SplatSelection : public rviz_common::interaction::SelectionHandler {
 public:
  // That which the displays of a process share.
  static std::shared_ptr<SplatSelection> ofProcess(rviz_common::DisplayContext* context);
  // Made by createSelectionHandler(), as every handler.
  explicit SplatSelection(rviz_common::DisplayContext* context) : SelectionHandler(context) {}

  // Of the cloud, which hangs on the node, for as long as it is held; both must outlive it.
  std::shared_ptr<MapSelection> of(SplatCloud* cloud, Ogre::SceneNode* node,
                                   MapSelection::SelectCallback on_select);

  // Render thread: takes what has been found since, and reads what is selected again where a map
  // has changed. updateProperties() shows it.
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
    bool adds;  // to what is selected, or removes from it

    bool found() const;
  };

  void leave(MapSelection* map);
  void begin(bool adds);
  bool take();
  void take(Waiting& found);
  void drawOutlines();
  void list(rviz_common::properties::Property* parent);

  std::vector<MapSelection*> maps_;
  std::set<std::uint64_t> tickets_;  // selected
  std::deque<Waiting> waiting_;      // picks whose slots aren't known yet
  std::string error_;                // why those of the last never will be
  bool shown_ = true;                // outlines and panel show what is known
};

}  // namespace rosplat
