#pragma once

#include <OgreMovableObject.h>
#include <OgreRenderQueueSortingGrouping.h>
#include <OgreRenderable.h>

#include <array>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "splat_scene.hpp"

namespace rosplat {

// A map as a part of an Ogre scene: drawn after everything opaque, hidden by it, before and behind
// what is translucent. It is where setPlace() says, wherever the node is that it is attached to.
// The clouds of a view are drawn together, by the first that Ogre comes to: in one order, where the
// same draws them.
class SplatCloud : public Ogre::MovableObject {
 public:
  // Names the view that a viewport shows and registers its camera with the scene; called in the
  // render thread before each draw. `camera` is what the viewport's Ogre camera sees of the map.
  // Without a name nothing is drawn, and the map only kept up to date.
  using ViewCallback = std::function<std::string(Ogre::Viewport*, const SplatCamera& camera)>;

  // Shaders are read from the Ogre resource group that holds ogre_media.
  SplatCloud(const std::string& name, const std::string& resource_group, ViewCallback on_view);

  SplatScene& scene() { return *scene_; }
  const RenderSettings& settings() const { return settings_; }
  void setSettings(const RenderSettings& settings) { settings_ = settings; }
  // Where the map's frame is in the scene; a node has only floats for that.
  void setPlace(const Placement& place) { place_ = place; }
  const Placement& place() const { return place_; }
  // Sort in the next draws rather than take what order there is.
  void setSortNow(bool sort_now) { sort_now_ = sort_now; }

  // What rviz's selection knows clouds by, 24 bits; 0: they can't be selected. What is selected, it
  // knows by a ticket, another with each pick.
  void setPickHandle(std::uint32_t handle) {
    pick_handle_ = handle;
    picked_with_.clear();
  }
  // Right after a pick: which splats that were, of this cloud and those that were drawn with it;
  // none where another has drawn it.
  std::vector<std::pair<SplatCloud*, Pick>> pick();

  // A sentence for the user; drawing pauses for a second, or until clearError().
  const std::string& error() const { return error_; }
  void clearError() { error_.clear(); }

  // Ogre::MovableObject
  const Ogre::String& getMovableType() const override;
  const Ogre::AxisAlignedBox& getBoundingBox() const override;
  Ogre::Real getBoundingRadius() const override;
  void _notifyCurrentCamera(Ogre::Camera* camera) override;
  void _updateRenderQueue(Ogre::RenderQueue* queue) override;
  void visitRenderables(Ogre::Renderable::Visitor* visitor, bool debug) override;

 private:
  // When a part of the map is drawn, in this order.
  enum class Turn {
    kBehind,  // between the opaque and the translucent objects, if there are any
    kHide,    // the same, once all maps are through with kBehind
    kBefore,  // after both, before overlays
  };
  // What Ogre's queues hold.
  class Layer : public Ogre::Renderable {
   public:
    Layer(SplatCloud& cloud, Turn turn) : cloud_(cloud), turn_(turn) {}
    const Ogre::MaterialPtr& getMaterial() const override { return cloud_.material_; }
    void getRenderOperation(Ogre::RenderOperation& operation) override;
    void getWorldTransforms(Ogre::Matrix4* transform) const override;
    Ogre::Real getSquaredViewDepth(const Ogre::Camera* camera) const override;
    const Ogre::LightList& getLights() const override { return cloud_.queryLights(); }
    bool preRender(Ogre::SceneManager* manager, Ogre::RenderSystem* system) override;

    SplatCloud& cloud() const { return cloud_; }

   private:
    SplatCloud& cloud_;
    Turn turn_;
  };

  // Clouds that are drawn together, and their maps.
  struct Group {
    std::vector<SplatCloud*> clouds;
    std::vector<SplatScene::InView> maps;
  };

  // That Ogre is drawing now, in the order in which they were made.
  static std::vector<SplatCloud*> cloudsIn(Ogre::SceneManager& manager);
  void draw(Turn turn, Ogre::SceneManager& manager);
  void drawSeen(Turn turn, Ogre::SceneManager& manager, Canvas canvas);
  // For rviz's mouse tools.
  void drawTouched(Ogre::SceneManager& manager, Canvas canvas);
  // Draws all that Ogre is drawing now, as a method finds each.
  using Find = std::optional<SplatScene::InView> (SplatCloud::*)(Ogre::Viewport*);
  static void drawAll(Ogre::SceneManager& manager, Find find,
                      const std::function<void(const Group&)>& draw);
  // The map as a viewport sees it, if it is to be drawn; after an error it isn't for a while.
  std::optional<SplatScene::InView> seen(Ogre::Viewport* viewport);
  // The same of a viewport of rviz's mouse tools, if the map was seen.
  std::optional<SplatScene::InView> touched(Ogre::Viewport* viewport);
  SplatCamera cameraIn(const Ogre::Viewport& viewport) const;
  bool pauses() const;
  void fail(const std::exception& error);
  std::vector<Ogre::RenderablePass> translucent(Ogre::SceneManager& manager) const;
  static bool anyOpaque(Ogre::SceneManager& manager);  // before the splats in this view

  std::array<Layer, 3> layers_{Layer(*this, Turn::kBehind), Layer(*this, Turn::kHide),
                               Layer(*this, Turn::kBefore)};
  const std::uint64_t number_;  // of those that were ever made
  std::unique_ptr<SplatScene> scene_;
  ViewCallback on_view_;
  std::map<std::string, SplatCamera> seen_;  // by view, as drawn last; mouse tools draw parts
  RenderSettings settings_;
  Placement place_;
  bool sort_now_ = false;
  std::uint32_t pick_handle_ = 0;
  std::vector<SplatCloud*> picked_with_;  // those that it has drawn in the last pick, itself first
  bool drawn_ = false;                    // in this frame
  // The view that was drawn, if it was divided at the translucent objects: kHide and kBefore
  // follow.
  std::string divided_;
  std::string error_;
  std::chrono::steady_clock::time_point error_ends_;
  Ogre::MaterialPtr material_;
  Ogre::AxisAlignedBox box_ = Ogre::AxisAlignedBox::BOX_INFINITE;
  Ogre::Camera* camera_ = nullptr;
};

}  // namespace rosplat
