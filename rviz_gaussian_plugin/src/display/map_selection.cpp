#include "map_selection.hpp"

#include <OgreManualObject.h>
#include <OgreMaterialManager.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>

#include <QColor>
#include <QStringList>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <rviz_common/properties/color_property.hpp>
#include <rviz_rendering/material_manager.hpp>
#include <utility>

#include "rosplat_core/slots/constants.hpp"
#include "splat_outline.hpp"

namespace rosplat {

namespace {

using rviz_common::properties::Property;

constexpr std::chrono::milliseconds kRefreshPeriod{250};  // of a map that changes all the time
constexpr float kOutlineSigmas = 2;  // where a splat still has an eighth of its opacity

// Slots may be emptied while they are selected.
bool inUse(const SplatValues& splat) { return splat.opacity > 0; }

// Rounds to a unit, not to so many digits: coordinates far from the frame's origin stay whole.
template <typename Values>
QString text(const Values& values, double unit) {
  QStringList numbers;
  for (const double value : values) {
    numbers.append(QString::number(unit * std::round(value / unit), 'g', 12));
  }
  return numbers.join("; ");
}

QColor baseColour(const SplatValues& splat) {
  std::array<int, 3> rgb{};
  for (std::size_t i = 0; i < 3; ++i) {
    rgb[i] = std::clamp(int(255 * (0.5f + float(kShC0) * splat.sh[i]) + 0.5f), 0, 255);
  }
  return {rgb[0], rgb[1], rgb[2]};
}

Property* describe(const SplatValues& splat, const std::vector<Channel>& channels) {
  auto* parent = new Property(QString("Slot %1").arg(splat.slot));
  const auto add = [parent](const QString& name, const QString& value, const char* description) {
    (new Property(name, value, description, parent))->setReadOnly(true);
  };
  if (!inUse(splat)) {
    parent->setValue("empty");
  } else {
    add("Position", text(splat.position, 1e-4), "Mean x; y; z in the map's frame. [m]");
    add("Orientation", text(splat.orientation, 1e-3), "Of the principal axes: x; y; z; w.");
    add("Scale", text(splat.scale, 1e-5), "Standard deviations along the principal axes. [m]");
    add("Opacity", QString::number(splat.opacity, 'g', 4), "At the peak, 0 to 1.");
    (new rviz_common::properties::ColorProperty(
         "Base Color", baseColour(splat),
         "Band 0 of the spherical harmonics: the mean over all directions.", parent))
        ->setReadOnly(true);
    for (std::size_t i = 0; i < std::min(channels.size(), splat.channels.size()); ++i) {
      const float value = splat.channels[i];
      add(QString::fromStdString(channels[i].name),
          std::isfinite(value) ? QString::number(value, 'g', 9) : "none", "A channel of the map.");
    }
  }
  parent->setReadOnly(true);
  return parent;
}

// Slots in ascending order, each once, without kNoSlot.
Pick::Slots sorted(Pick::Slots picked) {
  std::sort(picked.begin(), picked.end());
  picked.erase(std::unique(picked.begin(), picked.end()), picked.end());
  if (!picked.empty() && picked.back() == kNoSlot) picked.pop_back();
  return picked;
}

}  // namespace

MapSelection::MapSelection(SplatCloud* cloud, Ogre::SceneNode* node, SelectCallback on_select)
    : cloud_(*cloud), on_select_(std::move(on_select)) {
  const std::string name = cloud_.getName() + "/selection";
  material_ = rviz_rendering::MaterialManager::createMaterialWithNoLighting(name);
  material_->setDepthCheckEnabled(false);  // selected splats are never hidden
  material_->setDepthWriteEnabled(false);
  outlines_ = std::make_unique<Ogre::ManualObject>(name);
  outlines_->setRenderQueueGroup(static_cast<Ogre::uint8>(cloud_.getRenderQueueGroup() + 1));
  outline_node_ = node->createChildSceneNode();
  outline_node_->attachObject(outlines_.get());
}

MapSelection::~MapSelection() {
  outline_node_->detachAllObjects();
  outline_node_->getParentSceneNode()->removeAndDestroyChild(outline_node_);
  outlines_.reset();
  Ogre::MaterialManager::getSingleton().remove(material_);
}

void MapSelection::add(Pick::Slots picked) {
  const Pick::Slots found = sorted(std::move(picked)), before = std::exchange(slots_, {});
  Pick::Slots fresh;
  std::set_difference(found.begin(), found.end(), before.begin(), before.end(),
                      std::back_inserter(fresh));
  std::set_union(before.begin(), before.end(), found.begin(), found.end(),
                 std::back_inserter(slots_));
  read();
  fresh.resize(std::min(fresh.size(), kListed));
  // The map may have changed since the pick.
  std::vector<SplatValues> selected = cloud_.scene().readSlots(fresh);
  selected.erase(std::stable_partition(selected.begin(), selected.end(), inUse), selected.end());
  if (!selected.empty()) on_select_(std::move(selected));
}

void MapSelection::remove(Pick::Slots picked) {
  const Pick::Slots found = sorted(std::move(picked)), before = std::exchange(slots_, {});
  std::set_difference(before.begin(), before.end(), found.begin(), found.end(),
                      std::back_inserter(slots_));
  read();
}

void MapSelection::clear() {
  slots_.clear();
  splats_.clear();
}

bool MapSelection::refresh() {
  const MapState& map = cloud_.scene().drawnMap();
  if (!slots_.empty() && map.begun != read_begun_) {  // its slots may be other splats
    const bool same_map = map.id == read_map_;
    if (same_map && !map.complete()) return false;
    const std::vector<SplatValues> before = splats_;
    read();
    const bool same = std::equal(
        before.begin(), before.end(), splats_.begin(), splats_.end(),
        [](const auto& a, const auto& b) { return a.slot == b.slot && a.position == b.position; });
    if (!same_map || !same) clear();
    return true;
  }
  const bool changed = map.id != read_map_ || map.revision != read_revision_;
  const bool late = std::chrono::steady_clock::now() - read_at_ >= kRefreshPeriod;
  if (slots_.empty() || !changed || !late) return false;
  read();
  return true;
}

void MapSelection::read() {
  const MapState& map = cloud_.scene().drawnMap();
  read_map_ = map.id;
  read_begun_ = map.begun;
  read_revision_ = map.revision;
  read_at_ = std::chrono::steady_clock::now();
  const auto end = slots_.begin() + std::ptrdiff_t(std::min(slots_.size(), kOutlined));
  splats_ = cloud_.scene().readSlots({slots_.begin(), end});
  const auto first = std::find_if(splats_.begin(), splats_.end(), inUse);
  if (first != splats_.end()) origin_ = first->position;
  follow();
}

void MapSelection::follow() {
  const Placement& map = cloud_.place();
  const auto [x, y, z] = map(origin_);
  outline_node_->setPosition(Ogre::Real(x), Ogre::Real(y), Ogre::Real(z));
  Ogre::Matrix3 rotation;
  for (int i = 0; i < 9; ++i) rotation[i / 3][i % 3] = Ogre::Real(map.rotation[i]);
  outline_node_->setOrientation(Ogre::Quaternion(rotation));
}

SplatValues MapSelection::outlined(const SplatValues& splat) const {
  SplatValues relative = splat;
  for (int i = 0; i < 3; ++i) relative.position[i] -= origin_[i];
  return relative;
}

void MapSelection::drawOutlines() {
  outlines_->clear();
  if (splats_.empty()) return;
  outlines_->begin(material_->getName(), Ogre::RenderOperation::OT_LINE_LIST,
                   material_->getGroup());
  for (const SplatValues& splat : splats_) {
    if (!inUse(splat)) continue;
    for (const Ogre::Vector3& end : outline(outlined(splat), kOutlineSigmas)) {
      outlines_->position(end);
      outlines_->colour(Ogre::ColourValue(0, 1, 1));
    }
  }
  outlines_->end();
}

void MapSelection::setVisible(bool visible) { outline_node_->setVisible(visible); }

std::vector<Property*> MapSelection::describe() const {
  std::vector<Property*> lines;
  for (std::size_t i = 0; i < std::min(splats_.size(), kListed); ++i) {
    lines.push_back(rosplat::describe(splats_[i], cloud_.scene().drawnMap().channels));
  }
  if (slots_.size() > kListed) {
    lines.push_back(new Property(QString("... and %1 more").arg(slots_.size() - kListed)));
  }
  return lines;
}

std::vector<Ogre::AxisAlignedBox> MapSelection::boxes() const {
  const Ogre::Affine3 map(outline_node_->_getFullTransform());
  std::vector<Ogre::AxisAlignedBox> boxes;
  for (const SplatValues& splat : splats_) {
    if (inUse(splat)) boxes.push_back(boxAround(outlined(splat), kOutlineSigmas, map));
  }
  return boxes;
}

}  // namespace rosplat
