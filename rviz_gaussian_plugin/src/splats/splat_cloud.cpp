#include "splat_cloud.hpp"

#include <OgreCamera.h>
#include <OgreEntity.h>
#include <OgreFrameListener.h>
#include <OgreMaterialManager.h>
#include <OgreRenderQueue.h>
#include <OgreRenderTarget.h>
#include <OgreResourceGroupManager.h>
#include <OgreRoot.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreSubEntity.h>
#include <OgreTechnique.h>
#include <OgreViewport.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "gl/object.hpp"

namespace rosplat {

namespace {

// After the opaque and the translucent objects of the scene, before overlays.
constexpr Ogre::uint8 kRenderQueue = Ogre::RENDER_QUEUE_7;
constexpr std::uint32_t kMostTickets = (1u << 24) - 1;  // a pixel of rviz's selection has 24 bits

std::uint64_t made = 0;  // clouds so far

// Has Ogre sort the entries among the translucent objects, farthest first. Nothing is drawn with
// it.
Ogre::MaterialPtr entryMaterial() {
  auto& materials = Ogre::MaterialManager::getSingleton();
  const std::string name = "rosplat/QueueEntry";
  if (auto material =
          materials.getByName(name, Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME))
    return material;
  auto material = materials.getDefaultMaterial(false)->clone(
      name, true, Ogre::ResourceGroupManager::DEFAULT_RESOURCE_GROUP_NAME);
  material->setSceneBlending(Ogre::SBT_TRANSPARENT_ALPHA);
  material->setDepthWriteEnabled(false);
  return material;
}

// Deletes OpenGL objects that destroyed maps have left, while Ogre's context is current.
struct Undertaker : Ogre::FrameListener {
  bool frameEnded(const Ogre::FrameEvent&) override {
    gl::deleteAbandoned();
    return true;
  }
};

void callUndertaker() {
  static auto* const undertaker = new Undertaker;  // Ogre may end after all statics
  Ogre::Root::getSingleton().addFrameListener(undertaker);
}

// Lists the renderables in a queue.
struct Lister : Ogre::QueuedRenderableVisitor {
  std::vector<Ogre::RenderablePass> found;
  void visit(Ogre::RenderablePass* object) override { found.push_back(*object); }
  void visit(const Ogre::Pass* pass, Ogre::RenderableList& objects) override {
    for (auto* object : objects) found.emplace_back(object, const_cast<Ogre::Pass*>(pass));
  }
};

// Lists the translucent renderables of a queue, farthest first, or its solid ones, or both.
std::vector<Ogre::RenderablePass> listed(Ogre::RenderQueueGroup& queue, bool translucent,
                                         bool solid) {
  Lister lister;
  auto priorities = queue.getIterator();
  while (priorities.hasMoreElements()) {
    auto* const group = priorities.getNext();
    using Collection = Ogre::QueuedRenderableCollection;
    if (translucent)
      group->getTransparents().acceptVisitor(&lister, Collection::OM_SORT_DESCENDING);
    if (solid) group->getSolidsBasic().acceptVisitor(&lister, Collection::OM_PASS_GROUP);
  }
  return std::move(lister.found);
}

// The part of a camera's picture that some objects may cover. All of it if their bounds aren't
// known, or reach behind the camera.
PictureRect reachOf(const std::vector<Ogre::RenderablePass>& objects,
                    const Ogre::Viewport& viewport) {
  constexpr float kMargin = 2;  // [px]
  const int width = viewport.getActualWidth(), height = viewport.getActualHeight();
  const Ogre::Camera& camera = *viewport.getCamera();
  const PictureRect all{0, 0, width, height};
  const Ogre::Matrix4 projection = camera.getProjectionMatrix() * camera.getViewMatrix();
  Ogre::AxisAlignedBox reach;  // x and y in pixels
  for (const Ogre::RenderablePass& object : objects) {
    const auto* part = dynamic_cast<const Ogre::SubEntity*>(object.renderable);
    if (!part) return all;
    const Ogre::AxisAlignedBox& bounds = part->getParent()->getWorldBoundingBox(true);
    if (!bounds.isFinite()) return all;
    for (const Ogre::Vector3& corner : bounds.getAllCorners()) {
      const Ogre::Vector4 clip = projection * Ogre::Vector4(corner);
      if (!(clip.w > 0)) return all;
      reach.merge(Ogre::Vector3(0.5f * float(width) * (1 + clip.x / clip.w),
                                0.5f * float(height) * (1 - clip.y / clip.w), 0));
    }
  }
  if (reach.isNull()) return {};
  const auto within = [](float place, int most) {
    return static_cast<int>(std::clamp(place, 0.0f, static_cast<float>(most)));
  };
  return {within(std::floor(reach.getMinimum().x - kMargin), width),
          within(std::floor(reach.getMinimum().y - kMargin), height),
          within(std::ceil(reach.getMaximum().x + kMargin), width),
          within(std::ceil(reach.getMaximum().y + kMargin), height)};
}

// Makes the rows of a rotation of 32-bit floats perpendicular and of unit length: the floats'
// errors would move a map that is 4,500 km away by a quarter of a metre.
void orthonormalise(std::array<double, 9>& rotation) {
  for (int i = 0; i < 3; ++i) {
    double* row = &rotation[3 * i];
    const auto dot = [row](const double* o) {
      return row[0] * o[0] + row[1] * o[1] + row[2] * o[2];
    };
    for (int j = 0; j < i; ++j) {
      const double* other = &rotation[3 * j];
      const double along = dot(other);
      for (int k = 0; k < 3; ++k) row[k] -= along * other[k];
    }
    const double length = std::sqrt(dot(row));
    for (int k = 0; k < 3; ++k) row[k] /= length;
  }
}

// Has the stencil cleared with the depth. To clear half of their one buffer, software rendering
// reads it all first, which takes a fifth of the time of an rviz frame without displays.
void clearStencilToo(Ogre::Viewport& viewport) {
  const unsigned int cleared = viewport.getClearBuffers();
  if ((cleared & Ogre::FBT_DEPTH) && !(cleared & Ogre::FBT_STENCIL)) {
    viewport.setClearEveryFrame(viewport.getClearEveryFrame(), cleared | Ogre::FBT_STENCIL);
  }
}

// A narrow box of rviz's selection may have no pixels once shrunk to its texture.
bool hasPixels(const Ogre::Viewport& viewport) {
  return viewport.getActualWidth() > 0 && viewport.getActualHeight() > 0;
}

// rviz's mouse tools draw the scene in schemes of their own.
bool showsScene(const Ogre::Viewport& viewport) {
  return hasPixels(viewport) &&
         viewport.getMaterialScheme() == Ogre::MaterialManager::DEFAULT_SCHEME_NAME;
}

Canvas canvasOf(const Ogre::Viewport& viewport) {
  return viewport.getTarget()->requiresTextureFlipping() ? Canvas::kTexture : Canvas::kWindow;
}

// Converts a viewport's camera to the optical convention.
SplatCamera cameraOf(const Ogre::Viewport& viewport) {
  const Ogre::Camera& ogre = *viewport.getCamera();
  const int width = viewport.getActualWidth(), height = viewport.getActualHeight();
  SplatCamera camera;
  const Ogre::Matrix4 view = ogre.getViewMatrix();
  const Ogre::Matrix4 projection = ogre.getProjectionMatrix();
  for (int i = 0; i < 3; ++i) {
    const double sign = i == 0 ? 1.0 : -1.0;  // OpenGL's y up, z backward to y down, z forward
    for (int k = 0; k < 3; ++k) camera.rotation[3 * i + k] = sign * view[i][k];
    camera.translation[i] = sign * view[i][3];
    camera.rounding = std::max(camera.rounding, std::fabs(camera.translation[i]));
  }
  orthonormalise(camera.rotation);
  camera.rounding *= 0.5 * std::numeric_limits<Ogre::Real>::epsilon();
  camera.orthographic = projection[3][3] != 0;  // whatever the type says: rviz sets matrices
  camera.width = width;
  camera.height = height;
  camera.fx = 0.5 * width * projection[0][0];
  camera.fy = 0.5 * height * projection[1][1];
  if (camera.orthographic) {
    camera.cx = 0.5 * width * (1.0 + projection[0][3]);
    camera.cy = 0.5 * height * (1.0 - projection[1][3]);
  } else {
    camera.cx = 0.5 * width * (1.0 - projection[0][2]);
    camera.cy = 0.5 * height * (1.0 + projection[1][2]);
  }
  camera.ndc_scale = -projection[2][2];
  camera.ndc_offset = projection[2][3];
  // From the matrix: rviz's selection camera has a matrix of its own, but Ogre's default distances.
  const double nearest = (-1 - camera.ndc_offset) / camera.ndc_scale;
  camera.near_clip = camera.orthographic ? nearest : -camera.ndc_offset / (1 + camera.ndc_scale);
  if (ogre.getFarClipDistance() > 0) camera.far_clip = ogre.getFarClipDistance();  // 0: infinite
  return camera;
}

}  // namespace

SplatCloud::SplatCloud(const std::string& name, const std::string& resource_group,
                       ViewCallback on_view)
    : Ogre::MovableObject(name),
      number_(++made),
      scene_(std::make_unique<SplatScene>(
          Renderers::ofProcess([resource_group](const std::string& shader) {
            return Ogre::ResourceGroupManager::getSingleton()
                .openResource(shader, resource_group)
                ->getAsString();
          }))),
      on_view_(std::move(on_view)),
      material_(entryMaterial()) {
  setRenderQueueGroup(kRenderQueue);
  setCastShadows(false);
  callUndertaker();
}

// The clouds of the view that Ogre is drawing, of which there is one at a time. Their pictures
// begin before Ogre draws anything. The first entry of a turn that Ogre comes to draws for all
// clouds.
class SplatCloud::OgreView : public Ogre::SceneManager::Listener {
 public:
  void postFindVisibleObjects(Ogre::SceneManager* manager,
                              Ogre::SceneManager::IlluminationRenderStage,
                              Ogre::Viewport* viewport) override;
  void draw(Turn turn, Ogre::SceneManager& manager);
  std::vector<std::pair<SplatCloud*, Pick>> takePicks();
  void forget(const SplatCloud* cloud);

 private:
  // Clouds that are drawn together.
  struct Group {
    std::vector<SplatCloud*> clouds;
    SplatScene::Picture picture;
  };

  static std::vector<SplatCloud*> cloudsIn(Ogre::SceneManager& manager);  // oldest first
  static std::vector<Ogre::RenderablePass> translucentIn(Ogre::SceneManager& manager);
  static bool anyOpaque(Ogre::SceneManager& manager);  // drawn before the splats

  // Prepares the clouds for a viewport by `enter`, and groups those that it shows.
  using Enter = std::optional<Layer<Drawer*>> (SplatCloud::*)(Ogre::Viewport*);
  void group(Enter enter, Ogre::Viewport* viewport);
  // Does something for each group. What it throws becomes the error of its clouds, and ends the
  // group.
  void forEach(const std::function<void(Group&)>& act);
  void drawAll(Turn turn, Ogre::SceneManager& manager);
  // For rviz's mouse tools.
  void drawTouched(Ogre::Viewport& viewport);

  std::vector<SplatCloud*> clouds_;  // oldest first
  std::vector<Group> groups_;
  std::optional<Turn> done_;  // the last turn that was drawn
  bool divided_ = false;      // at translucent objects: kHide and kBefore follow
  std::vector<std::vector<SplatCloud*>> picked_;  // the groups of the last pick
};

SplatCloud::OgreView& SplatCloud::ogreView() {
  static auto* const view = new OgreView;  // scene managers may end after all statics
  return *view;
}

SplatCloud::~SplatCloud() { ogreView().forget(this); }

void SplatCloud::_notifyAttached(Ogre::Node* parent, bool is_tag_point) {
  MovableObject::_notifyAttached(parent, is_tag_point);
  if (const auto* node = dynamic_cast<Ogre::SceneNode*>(parent)) {
    node->getCreator()->removeListener(&ogreView());  // not twice
    node->getCreator()->addListener(&ogreView());
  }
}

const Ogre::String& SplatCloud::getMovableType() const {
  static const Ogre::String type = "SplatCloud";
  return type;
}

const Ogre::AxisAlignedBox& SplatCloud::getBoundingBox() const { return box_; }

Ogre::Real SplatCloud::getBoundingRadius() const { return 0; }

void SplatCloud::_updateRenderQueue(Ogre::RenderQueue* queue) {
  auto& [behind, hide, before] = entries_;
  queue->addRenderable(&behind, Ogre::RENDER_QUEUE_MAIN, mRenderQueuePriority);
  queue->addRenderable(&hide, Ogre::RENDER_QUEUE_MAIN, mRenderQueuePriority);
  queue->addRenderable(&before, mRenderQueueID, mRenderQueuePriority);
}

void SplatCloud::visitRenderables(Ogre::Renderable::Visitor* visitor, bool) {
  for (QueueEntry& entry : entries_) visitor->visit(&entry, 0, false);
}

void SplatCloud::QueueEntry::getRenderOperation(Ogre::RenderOperation& operation) {
  operation.vertexData = nullptr;  // preRender() draws
}

void SplatCloud::QueueEntry::getWorldTransforms(Ogre::Matrix4* transform) const {
  *transform = cloud_._getParentNodeFullTransform();
}

// Farther than all translucent objects, so that Ogre comes to the entry first.
Ogre::Real SplatCloud::QueueEntry::getSquaredViewDepth(const Ogre::Camera*) const {
  const Ogre::Real farthest = std::numeric_limits<Ogre::Real>::max();
  return turn_ == Turn::kBehind ? farthest : farthest / 2;
}

bool SplatCloud::QueueEntry::preRender(Ogre::SceneManager* manager, Ogre::RenderSystem*) {
  ogreView().draw(turn_, *manager);
  return false;
}

bool SplatCloud::pauses() const {
  return !error_.empty() && (scene_->unusable() || std::chrono::steady_clock::now() < error_ends_);
}

void SplatCloud::fail(const std::exception& error) {
  error_ = error.what();
  error_ends_ = std::chrono::steady_clock::now() + std::chrono::seconds(1);
}

SplatCamera SplatCloud::cameraIn(const Ogre::Viewport& viewport) const {
  SplatCamera camera = inFrameOf(place_, cameraOf(viewport));
  camera.extent_scale = extentScale(settings_);
  return camera;
}

std::optional<Layer<Drawer*>> SplatCloud::enterView(Ogre::Viewport* viewport) {
  if (pauses()) return {};
  if (before_view_) before_view_();
  const SplatCamera camera = cameraIn(*viewport);
  const std::string view = on_view_(viewport, camera);
  if (view.empty()) {
    seen_.clear();
    scene_->upload(settings_);
    error_.clear();
    return {};
  }
  for (auto of = seen_.begin(); of != seen_.end();) {
    of = scene_->knows(of->first) ? std::next(of) : seen_.erase(of);
  }
  seen_[view] = camera;
  scene_->upload(settings_, sort_now_);
  return scene_->layer(view, settings_, sort_now_);
}

std::optional<Layer<Drawer*>> SplatCloud::enterMouseTool(Ogre::Viewport* viewport) {
  if (seen_.empty() || pauses()) return {};  // what isn't seen can't be touched
  SplatCamera camera = cameraIn(*viewport);
  auto view = seen_.begin();
  while (view != seen_.end() && !makePart(camera, view->second)) ++view;
  if (view == seen_.end()) view = seen_.begin();  // the camera has moved since
  scene_->prepare(settings_);
  return scene_->layerUnderMouse(view->first, settings_, camera);
}

// --- A view --------------------------------------------------------------------------------------

std::vector<SplatCloud*> SplatCloud::OgreView::cloudsIn(Ogre::SceneManager& manager) {
  std::vector<SplatCloud*> clouds;
  // In the schemes of rviz's mouse tools the entries are solids.
  for (const Ogre::RenderablePass& object :
       listed(*manager.getRenderQueue()->getQueueGroup(kRenderQueue), true, true)) {
    if (const auto* entry = dynamic_cast<QueueEntry*>(object.renderable)) {
      clouds.push_back(&entry->cloud());
    }
  }
  std::sort(clouds.begin(), clouds.end(),
            [](const SplatCloud* a, const SplatCloud* b) { return a->number_ < b->number_; });
  return clouds;
}

std::vector<Ogre::RenderablePass> SplatCloud::OgreView::translucentIn(Ogre::SceneManager& manager) {
  auto found =
      listed(*manager.getRenderQueue()->getQueueGroup(Ogre::RENDER_QUEUE_MAIN), true, false);
  const auto is_entry = [](const Ogre::RenderablePass& object) {
    return dynamic_cast<const QueueEntry*>(object.renderable) != nullptr;
  };
  found.erase(std::remove_if(found.begin(), found.end(), is_entry), found.end());
  return found;
}

bool SplatCloud::OgreView::anyOpaque(Ogre::SceneManager& manager) {
  const auto& queues = manager.getRenderQueue()->_getQueueGroups();
  return std::any_of(&queues[0], &queues[kRenderQueue], [](const auto& queue) {
    return queue && !listed(*queue, false, true).empty();
  });
}

void SplatCloud::OgreView::postFindVisibleObjects(Ogre::SceneManager* manager,
                                                  Ogre::SceneManager::IlluminationRenderStage,
                                                  Ogre::Viewport* viewport) {
  groups_.clear();
  done_.reset();
  divided_ = false;
  clouds_ = cloudsIn(*manager);
  if (clouds_.empty() || !showsScene(*viewport)) return;
  clearStencilToo(*viewport);
  group(&SplatCloud::enterView, viewport);
  forEach([&](Group& group) { group.picture.begin(canvasOf(*viewport)); });
}

void SplatCloud::OgreView::draw(Turn turn, Ogre::SceneManager& manager) {
  if (done_ && turn <= *done_) return;
  Ogre::Viewport& viewport = *manager.getCurrentViewport();
  if (!showsScene(viewport)) {
    if (turn == Turn::kBefore && hasPixels(viewport)) drawTouched(viewport);
  } else if (!done_) {
    return drawAll(turn, manager);
  } else if (divided_) {
    forEach([turn](const Group& group) {
      turn == Turn::kHide ? group.picture.hideFarther() : group.picture.drawBefore();
    });
  }
  done_ = turn;
}

void SplatCloud::OgreView::group(Enter enter, Ogre::Viewport* viewport) {
  groups_.clear();
  for (SplatCloud* cloud : clouds_) {
    try {
      const std::optional<Layer<Drawer*>> layer = (cloud->*enter)(viewport);
      if (!layer) continue;
      SplatScene& scene = *cloud->scene_;
      auto group = std::find_if(groups_.begin(), groups_.end(), [&scene](const Group& other) {
        return other.picture.takes(scene);
      });
      if (group == groups_.end()) group = groups_.insert(group, Group{});
      group->clouds.push_back(cloud);
      group->picture.add(scene, *layer);
    } catch (const std::exception& error) {
      cloud->fail(error);
    }
  }
}

void SplatCloud::OgreView::forEach(const std::function<void(Group&)>& act) {
  const auto fails = [&act](Group& group) {
    try {
      act(group);
      return false;
    } catch (const std::exception& error) {
      for (SplatCloud* cloud : group.clouds) cloud->fail(error);
      return true;
    }
  };
  groups_.erase(std::remove_if(groups_.begin(), groups_.end(), fails), groups_.end());
}

// In kBehind if there are translucent objects, else in kBefore.
void SplatCloud::OgreView::drawAll(Turn turn, Ogre::SceneManager& manager) {
  const Ogre::Viewport& viewport = *manager.getCurrentViewport();
  Surroundings around;
  if (turn != Turn::kBefore) {
    const auto objects = translucentIn(manager);
    if (objects.empty()) return;
    around.translucent = [&manager, objects] {
      for (const auto& [object, pass] : objects) {
        const bool writes = pass->getDepthWriteEnabled();
        pass->setDepthWriteEnabled(true);
        manager._injectRenderWithPass(pass, object, false);
        pass->setDepthWriteEnabled(writes);
      }
    };
    around.translucent_in = reachOf(objects, viewport);
  }
  around.opaque = anyOpaque(manager);
  done_ = turn;
  divided_ = static_cast<bool>(around.translucent);
  forEach([&](Group& group) {
    group.picture.draw(around);
    for (SplatCloud* cloud : group.clouds) cloud->error_.clear();
  });
}

void SplatCloud::OgreView::drawTouched(Ogre::Viewport& viewport) {
  static std::uint32_t ticket = 0;
  const std::string& scheme = viewport.getMaterialScheme();
  const std::uint32_t handle = clouds_.front()->pick_handle_;
  const bool picks = handle && (scheme == "Pick" || scheme == "Pick1");
  if (!picks && scheme != "Depth") return;
  if (scheme == "Pick") ticket = ticket % kMostTickets + 1;
  const Canvas canvas = canvasOf(viewport);
  group(&SplatCloud::enterMouseTool, &viewport);
  forEach([&](const Group& group) {
    picks ? group.picture.drawPick(canvas, scheme == "Pick" ? handle : ticket)
          : group.picture.drawSurface(canvas, viewport.getCamera()->getFarClipDistance());
  });
  if (!picks) return;
  picked_.clear();
  for (const Group& group : groups_) picked_.push_back(group.clouds);
}

std::vector<std::pair<SplatCloud*, Pick>> SplatCloud::OgreView::takePicks() {
  std::vector<std::pair<SplatCloud*, Pick>> picks;
  for (const std::vector<SplatCloud*>& clouds : std::exchange(picked_, {})) {
    std::vector<Pick> found = clouds.front()->scene_->pick();
    for (std::size_t i = 0; i < found.size(); ++i)
      picks.emplace_back(clouds[i], std::move(found[i]));
  }
  return picks;
}

void SplatCloud::OgreView::forget(const SplatCloud* cloud) {
  const auto has = [cloud](const std::vector<SplatCloud*>& clouds) {
    return std::find(clouds.begin(), clouds.end(), cloud) != clouds.end();
  };
  picked_.erase(std::remove_if(picked_.begin(), picked_.end(), has), picked_.end());
}

std::vector<std::pair<SplatCloud*, Pick>> SplatCloud::takePicks() { return ogreView().takePicks(); }

}  // namespace rosplat
