#include "splat_selection.hpp"

#include <algorithm>
#include <rviz_common/display_context.hpp>
#include <rviz_common/interaction/handler_manager_iface.hpp>
#include <rviz_common/properties/property.hpp>
#include <utility>

namespace rosplat {

using rviz_common::interaction::Picked;
using rviz_common::properties::Property;

std::shared_ptr<SplatSelection> SplatSelection::ofProcess(rviz_common::DisplayContext* context) {
  static std::weak_ptr<SplatSelection> known;
  std::shared_ptr<SplatSelection> selection = known.lock();
  if (!selection) {
    known = selection = rviz_common::interaction::createSelectionHandler<SplatSelection>(context);
  }
  return selection;
}

std::shared_ptr<MapSelection> SplatSelection::of(SplatCloud* cloud, Ogre::SceneNode* node,
                                                 MapSelection::SelectCallback on_select) {
  const auto self = std::static_pointer_cast<SplatSelection>(shared_from_this());
  const std::shared_ptr<MapSelection> map(new MapSelection(cloud, node, std::move(on_select)),
                                          [self](MapSelection* gone) {
                                            self->removeMap(gone);
                                            delete gone;
                                          });
  maps_.push_back(map.get());
  addTrackedObject(cloud);
  return map;
}

void SplatSelection::removeMap(MapSelection* map) {
  SplatCloud* const cloud = &map->cloud();
  removeTrackedObject(cloud);
  maps_.erase(std::remove(maps_.begin(), maps_.end(), map), maps_.end());
  for (auto& [picks, adds] : waiting_) {
    const auto gone = [cloud](const auto& of) { return of.first == cloud; };
    picks.erase(std::remove_if(picks.begin(), picks.end(), gone), picks.end());
  }
  shown_ = false;
}

bool SplatSelection::Waiting::found() const {
  return std::all_of(picks.begin(), picks.end(), [](const auto& of) { return of.second.found(); });
}

void SplatSelection::preRenderPass(std::uint32_t) {
  // While markers can be dragged, rviz picks at every move of the mouse, and only for them.
  const bool drags = context_->getHandlerManager()->getInteractionEnabled();
  for (MapSelection* map : maps_) {
    map->setVisible(false);
    map->cloud().setPickHandle(drags ? 0 : getHandle());
  }
}

void SplatSelection::postRenderPass(std::uint32_t) {
  for (MapSelection* map : maps_) map->setVisible(true);
}

void SplatSelection::onSelect(const Picked& picked) {
  if (picked.extra_handles.empty()) return;
  tickets_.insert(picked.extra_handles.begin(), picked.extra_handles.end());
  begin(true);
}

void SplatSelection::onDeselect(const Picked& picked) {
  if (picked.extra_handles.empty()) return;
  // rviz deselects all that was selected, or splats that were picked only to be deselected.
  if (!tickets_.count(*picked.extra_handles.begin())) return begin(false);
  tickets_.clear();
  waiting_.clear();
  error_.clear();
  for (MapSelection* map : maps_) map->clear();
  drawOutlines();
}

// To be called right after a pick, while the context that it was drawn in is current.
void SplatSelection::begin(bool adds) {
  waiting_.push_back({SplatCloud::takePicks(), adds});
  if (applyFound()) drawOutlines();
}

// Applies picks that are found, in the order in which they began. Returns whether there were any.
bool SplatSelection::applyFound() {
  bool any = false;
  for (; !waiting_.empty() && waiting_.front().found(); waiting_.pop_front()) {
    any = true;
    error_.clear();
    try {
      apply(waiting_.front());
    } catch (const std::exception& error) {
      error_ = error.what();
    }
  }
  return any;
}

void SplatSelection::apply(Waiting& found) {
  for (auto& [cloud, pick] : found.picks) {
    const auto map = std::find_if(maps_.begin(), maps_.end(), [of = cloud](MapSelection* other) {
      return &other->cloud() == of;
    });
    found.adds ? (*map)->add(pick.slots()) : (*map)->remove(pick.slots());
  }
}

void SplatSelection::refresh() {
  bool fresh = applyFound();
  for (MapSelection* map : maps_) fresh = map->refresh() || fresh;
  if (fresh) shown_ = false;  // drawn by updateProperties(): Ogre is using the outlines now
}

void SplatSelection::drawOutlines() {
  for (MapSelection* map : maps_) map->drawOutlines();
  context_->queueRender();
}

void SplatSelection::createProperties(const Picked&, Property* parent) { list(parent); }

void SplatSelection::destroyProperties(const Picked&, Property* parent) { list(parent); }

void SplatSelection::updateProperties() {
  if (shown_ || properties_.isEmpty()) return;
  drawOutlines();
  list(properties_.front()->getParent());
}

void SplatSelection::list(Property* parent) {
  qDeleteAll(properties_);
  properties_.clear();
  for (const MapSelection* map : maps_) {
    for (Property* line : map->describe()) properties_.append(line);
  }
  if (!waiting_.empty()) properties_.append(new Property("Picking ..."));
  if (!error_.empty()) {
    properties_.append(new Property("Not picked", QString::fromStdString(error_)));
  }
  for (Property* property : properties_) parent->addChild(property);
  if (properties_.size() == 1) properties_.front()->expand();
  shown_ = true;
}

rviz_common::interaction::V_AABB SplatSelection::getAABBs(const Picked&) {
  rviz_common::interaction::V_AABB boxes;
  for (const MapSelection* map : maps_) {
    for (const Ogre::AxisAlignedBox& box : map->boxes()) boxes.push_back(box);
  }
  return boxes;
}

}  // namespace rosplat
