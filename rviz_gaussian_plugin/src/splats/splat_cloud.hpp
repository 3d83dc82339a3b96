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

// A map in an Ogre scene. Opaque objects are drawn before it and hide it; translucent objects are
// drawn between the splats behind and before them. setPlace() places the map, whatever the pose of
// its node. All clouds of a view are drawn at once: in one order if one renderer draws them.
class SplatCloud : public Ogre::MovableObject {
 public:
  // Registers with the scene that a viewport is about to show the map from a camera, which is in
  // the map's frame, and returns the view's name. If the name is empty, the map is kept up to date
  // but not drawn.
  using ViewCallback = std::function<std::string(Ogre::Viewport*, const SplatCamera& camera)>;

  // Shaders are read from the Ogre resource group that holds ogre_media.
  SplatCloud(const std::string& name, const std::string& resource_group, ViewCallback on_view);
  ~SplatCloud() override;

  // Called in the render thread before each view, with OpenGL's context current.
  void setBeforeView(std::function<void()> act) { before_view_ = std::move(act); }

  SplatScene& scene() { return *scene_; }
  const RenderSettings& settings() const { return settings_; }
  void setSettings(const RenderSettings& settings) { settings_ = settings; }
  // The pose of the map's frame in the scene. A node would round it to floats.
  void setPlace(const Placement& place) { place_ = place; }
  const Placement& place() const { return place_; }
  // Whether the next draws sort at once instead of taking the newest order.
  void setSortNow(bool sort_now) { sort_now_ = sort_now; }

  // The handle by which rviz's selection knows clouds, 24 bits; 0: the cloud can't be selected. The
  // selected splats have a ticket as their handle, a new one for each pick.
  void setPickHandle(std::uint32_t handle) { pick_handle_ = handle; }
  // Right after a pick, once: the picked splats of each cloud.
  static std::vector<std::pair<SplatCloud*, Pick>> takePicks();

  // A sentence for the user, empty without an error. After an error drawing pauses for a second, or
  // until clearError().
  const std::string& error() const { return error_; }
  void clearError() { error_.clear(); }

  // Ogre::MovableObject
  const Ogre::String& getMovableType() const override;
  const Ogre::AxisAlignedBox& getBoundingBox() const override;
  Ogre::Real getBoundingRadius() const override;
  void _notifyAttached(Ogre::Node* parent, bool is_tag_point) override;
  void _updateRenderQueue(Ogre::RenderQueue* queue) override;
  void visitRenderables(Ogre::Renderable::Visitor* visitor, bool debug) override;

 private:
  // When a part of a view's maps is drawn, in this order.
  enum class Turn {
    kBehind,  // between the opaque and the translucent objects, if there are translucent ones
    kHide,    // the same, after kBehind
    kBefore,  // after both, before overlays
  };
  // An entry in Ogre's queues: the first of a turn draws all clouds of the view.
  class QueueEntry : public Ogre::Renderable {
   public:
    QueueEntry(SplatCloud& cloud, Turn turn) : cloud_(cloud), turn_(turn) {}
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

  // The clouds of the view that Ogre is drawing.
  class OgreView;
  static OgreView& ogreView();

  // Brings the map up to date for a viewport. Returns what the viewport shows of it; none if it is
  // not to be drawn, as for a while after an error.
  std::optional<Layer<Drawer*>> enterView(Ogre::Viewport* viewport);
  // The same for a viewport of rviz's mouse tools; none if no view has shown the map.
  std::optional<Layer<Drawer*>> enterMouseTool(Ogre::Viewport* viewport);
  SplatCamera cameraIn(const Ogre::Viewport& viewport) const;
  bool pauses() const;
  void fail(const std::exception& error);

  std::array<QueueEntry, 3> entries_{QueueEntry(*this, Turn::kBehind),
                                     QueueEntry(*this, Turn::kHide),
                                     QueueEntry(*this, Turn::kBefore)};
  const std::uint64_t number_;  // counts the clouds that were ever made
  std::unique_ptr<SplatScene> scene_;
  ViewCallback on_view_;
  std::function<void()> before_view_;
  std::map<std::string, SplatCamera> seen_;  // last cameras by view; mouse tools draw parts
  RenderSettings settings_;
  Placement place_;
  bool sort_now_ = false;
  std::uint32_t pick_handle_ = 0;
  std::string error_;
  std::chrono::steady_clock::time_point error_ends_;
  Ogre::MaterialPtr material_;
  Ogre::AxisAlignedBox box_ = Ogre::AxisAlignedBox::BOX_INFINITE;
};

}  // namespace rosplat
