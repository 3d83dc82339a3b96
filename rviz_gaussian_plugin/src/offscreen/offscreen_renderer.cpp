#include "offscreen_renderer.hpp"

#include <OgreCamera.h>
#include <OgreHardwarePixelBuffer.h>
#include <OgreManualObject.h>
#include <OgreMaterialManager.h>
#include <OgreRenderTexture.h>
#include <OgreRenderWindow.h>
#include <OgreResourceGroupManager.h>
#include <OgreSceneManager.h>
#include <OgreSceneNode.h>
#include <OgreTechnique.h>
#include <OgreTextureManager.h>
#include <OgreViewport.h>
#include <epoxy/gl.h>

#include <stdexcept>
#include <tuple>

#include "gl/driver.hpp"
#include "gl/scopes.hpp"
#include "gl/shaders.hpp"

namespace rosplat {

namespace {
constexpr const char* kResourceGroup = "rosplat";

constexpr const char* kClear = R"(#version 430
layout(local_size_x = 16, local_size_y = 16) in;
layout(binding = 0, rgba8) writeonly uniform image2D picture;
uniform vec3 background;
void main() { imageStore(picture, ivec2(gl_GlobalInvocationID.xy), vec4(background, 1.0)); }
)";
}  // namespace

OffscreenRenderer::OffscreenRenderer(const std::string& media, const std::string& plugins)
    : log_(std::make_unique<Ogre::LogManager>()) {
  log_->createLog("", true, false, true)->setLogDetail(Ogre::LL_LOW);
  try {
    root_ = std::make_unique<Ogre::Root>("", "", "");
    root_->loadPlugin(plugins + "/RenderSystem_GL");
    root_->setRenderSystem(root_->getAvailableRenderers().front());
    root_->initialise(false);
    Ogre::NameValuePairList hidden{{"hidden", "true"}};
    root_->createRenderWindow("rosplat", 16, 16, false, &hidden);
  } catch (const Ogre::Exception& error) {
    throw std::runtime_error("no OpenGL window can be opened: " + error.getDescription());
  }
  graphics_ = std::string(reinterpret_cast<const char*>(glGetString(GL_RENDERER))) + ", OpenGL " +
              reinterpret_cast<const char*>(glGetString(GL_VERSION));
  if (gl::accelerated() && gl::unsupported().empty()) {
    clear_.emplace();
    clear_->attach(GL_COMPUTE_SHADER, "the clear", kClear);
    clear_->link("the clear");
  }
  auto& resources = Ogre::ResourceGroupManager::getSingleton();
  resources.addResourceLocation(media, "FileSystem", kResourceGroup);
  resources.initialiseResourceGroup(kResourceGroup);
  manager_ = root_->createSceneManager();
  camera_ = manager_->createCamera("camera");
  manager_->getRootSceneNode()->createChildSceneNode("camera")->attachObject(camera_);
  addMap();
}

OffscreenRenderer::~OffscreenRenderer() {
  for (const auto& cloud : clouds_) cloud->detachFromParent();
  clouds_.clear();  // while their OpenGL context exists
  if (texture_) {
    Ogre::TextureManager::getSingleton().remove(texture_);
    texture_.reset();
  }
}

SplatScene& OffscreenRenderer::addMap() {
  const std::string name = "map " + std::to_string(clouds_.size());
  clouds_.push_back(std::make_unique<SplatCloud>(
      name, kResourceGroup, [this](Ogre::Viewport*, const SplatCamera&) { return view_id_; }));
  manager_->getRootSceneNode()->createChildSceneNode(name)->attachObject(clouds_.back().get());
  return clouds_.back()->scene();
}

void OffscreenRenderer::setCamera(const std::string& view_id, std::uint64_t sequence,
                                  const SplatCamera& camera) {
  auto& [asked, mine] = cameras_[view_id] = {sequence, camera};
  mine.extent_scale = extentScale(settings);
  std::tie(mine.ndc_scale, mine.ndc_offset) = depthBuffer(
      camera.orthographic, camera.near_clip, depthRange(camera.near_clip, camera.far_clip));
  for (const auto& cloud : clouds_) cloud->scene().setCamera(view_id, sequence, mine);
}

const SplatCamera& OffscreenRenderer::cameraOf(const std::string& view_id) const {
  const auto found = cameras_.find(view_id);
  if (found == cameras_.end()) throw std::runtime_error("view '" + view_id + "' has no camera");
  return found->second.second;
}

SplatScene& OffscreenRenderer::drawn() {
  if (!drawn_) throw std::runtime_error("there is no picture: nothing was drawn, or it failed");
  return scene();
}

std::vector<float> OffscreenRenderer::readDepth() {
  SplatScene& scene = drawn();
  if (picked_) update();  // pick() has projected the splats of a part of the picture instead
  return scene.readDepth();
}

void OffscreenRenderer::resize(int width, int height) {
  if (texture_ && this->width() == width && this->height() == height) return;
  if (texture_) Ogre::TextureManager::getSingleton().remove(texture_);
  texture_ = Ogre::TextureManager::getSingleton().createManual(
      "picture", kResourceGroup, Ogre::TEX_TYPE_2D, Ogre::uint(width), Ogre::uint(height), 0,
      Ogre::PF_BYTE_RGBA, Ogre::TU_RENDERTARGET);
  Ogre::RenderTexture* target = texture_->getBuffer()->getRenderTarget();
  target->setAutoUpdated(false);
  Ogre::Viewport* viewport = target->addViewport(camera_);
  viewport->setOverlaysEnabled(false);
  paintBackground();
}

void OffscreenRenderer::paintBackground() {
  texture_->getBuffer()->getRenderTarget()->getViewport(0)->setBackgroundColour(
      Ogre::ColourValue(background_[0], background_[1], background_[2]));
}

FrameReport OffscreenRenderer::draw(const std::string& view_id, bool sort_now) {
  const SplatCamera& camera = cameraOf(view_id);
  if (camera.extent_scale != extentScale(settings)) {  // a scale that was set after the camera
    const auto [sequence, same] = cameras_.at(view_id);
    setCamera(view_id, sequence, same);
  }
  drawn_ = false;
  resize(camera.width, camera.height);
  view_id_ = view_id;
  for (const auto& cloud : clouds_) {
    cloud->setSortNow(sort_now);
    cloud->setSettings(settings);
  }

  // Ogre's camera draws the opaque objects; the splats are drawn with the exact camera.
  Ogre::Matrix4 view = Ogre::Matrix4::IDENTITY, projection = Ogre::Matrix4::ZERO;
  for (int i = 0; i < 3; ++i) {
    const double sign = i == 0 ? 1.0 : -1.0;
    for (int k = 0; k < 3; ++k) view[i][k] = Ogre::Real(sign * camera.rotation[3 * i + k]);
    view[i][3] = Ogre::Real(sign * camera.translation[i]);
  }
  projection[0][0] = Ogre::Real(2 * camera.fx / camera.width);
  projection[1][1] = Ogre::Real(2 * camera.fy / camera.height);
  const double offset_x = 1 - 2 * camera.cx / camera.width;
  const double offset_y = 2 * camera.cy / camera.height - 1;
  if (camera.orthographic) {
    projection[0][3] = Ogre::Real(-offset_x);
    projection[1][3] = Ogre::Real(-offset_y);
    projection[3][3] = 1;
  } else {
    projection[0][2] = Ogre::Real(offset_x);
    projection[1][2] = Ogre::Real(offset_y);
    projection[3][2] = -1;
  }
  projection[2][2] = Ogre::Real(-camera.ndc_scale);
  projection[2][3] = Ogre::Real(camera.ndc_offset);
  camera_->setProjectionType(camera.orthographic ? Ogre::PT_ORTHOGRAPHIC : Ogre::PT_PERSPECTIVE);
  camera_->setCustomProjectionMatrix(true, projection);
  camera_->setCustomViewMatrix(true, Ogre::Affine3(view));
  update();
  drawn_ = true;
  FrameReport report = scene().report(view_id);
  for (std::size_t i = 1; i < clouds_.size(); ++i) {
    report.splats += clouds_[i]->scene().report(view_id).splats;
  }
  return report;
}

void OffscreenRenderer::setBox(const std::array<float, 3>& centre, const std::array<float, 3>& size,
                               float opacity) {
  if (manager_->hasManualObject("box")) manager_->destroyManualObject("box");
  if (size == std::array<float, 3>{}) return;
  Ogre::ManualObject* box = manager_->createManualObject("box");
  auto& materials = Ogre::MaterialManager::getSingleton();
  auto material = materials.getByName("box", kResourceGroup);
  if (!material) {
    material = materials.getDefaultMaterial(false)->clone("box", true, kResourceGroup);
    material->getTechnique(0)->getPass(0)->setVertexColourTracking(Ogre::TVC_DIFFUSE);
  }
  material->setSceneBlending(opacity < 1 ? Ogre::SBT_TRANSPARENT_ALPHA : Ogre::SBT_REPLACE);
  material->setDepthWriteEnabled(opacity >= 1);
  box->begin(material->getName(), Ogre::RenderOperation::OT_TRIANGLE_LIST, material->getGroup());
  for (int corner = 0; corner < 8; ++corner) {
    Ogre::Vector3 position;
    for (int axis = 0; axis < 3; ++axis) {
      position[axis] = centre[axis] + (corner >> axis & 1 ? 0.5f : -0.5f) * size[axis];
    }
    box->position(position);
    box->colour(Ogre::ColourValue(1, 1, 1, opacity));
  }
  for (const std::array<Ogre::uint32, 4>& q : {std::array<Ogre::uint32, 4>{0, 2, 3, 1},
                                               {4, 5, 7, 6},
                                               {0, 1, 5, 4},
                                               {2, 6, 7, 3},
                                               {0, 4, 6, 2},
                                               {1, 3, 7, 5}}) {
    box->quad(q[0], q[1], q[2], q[3]);
  }
  box->end();
  manager_->getRootSceneNode()->attachObject(box);
}

std::vector<std::uint32_t> OffscreenRenderer::pick(const std::string& view_id, int left, int top,
                                                   int width, int height) {
  const SplatCamera part = crop(cameraOf(view_id), left, top, width, height);
  if (width < 1 || height < 1) return {};
  picked_ = true;
  SplatScene& scene = this->scene();
  scene.prepare(settings);
  SplatScene::Picture picture;
  picture.add(scene, scene.layerUnderMouse(view_id, settings, part));
  picture.drawPick(Canvas::kNone, 0);
  return scene.pick().front().slots();
}

std::vector<std::uint8_t> OffscreenRenderer::readPicture(const std::array<float, 3>& background) {
  drawn();
  if (background != background_) {
    background_ = background;
    paintBackground();
    update();
  }
  std::vector<std::uint8_t> pixels(3 * std::size_t(width()) * std::size_t(height()));
  texture_->getBuffer()->blitToMemory(Ogre::PixelBox(Ogre::uint32(width()), Ogre::uint32(height()),
                                                     1, Ogre::PF_BYTE_RGB, pixels.data()));
  return pixels;
}

void OffscreenRenderer::clear() const {
  GLuint picture = 0;
  texture_->getCustomAttribute("GLID", &picture);
  const gl::ComputeScope scope;
  clear_->use();
  glUniform3fv(clear_->at("background"), 1, background_.data());
  glBindImageTexture(0, picture, 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RGBA8);
  glDispatchCompute(GLuint(tilesIn(width())), GLuint(tilesIn(height())), 1);
  glMemoryBarrier(GL_FRAMEBUFFER_BARRIER_BIT | GL_SHADER_IMAGE_ACCESS_BARRIER_BIT |
                  GL_TEXTURE_UPDATE_BARRIER_BIT);
  glFlush();  // the graphics card begins
}

bool OffscreenRenderer::failed() const { return glGetError() != GL_NO_ERROR; }

void OffscreenRenderer::update() {
  picked_ = false;
  for (const auto& cloud : clouds_) cloud->clearError();
  Ogre::RenderTarget* target = texture_->getBuffer()->getRenderTarget();
  // To clear a picture or its depth by drawing takes a compute card as long as a small map.
  const bool box = manager_->hasManualObject("box"), computes = clear_ && !box;
  target->getViewport(0)->setClearEveryFrame(
      !computes, box ? Ogre::FBT_COLOUR | Ogre::FBT_DEPTH : Ogre::FBT_COLOUR);
  if (computes) clear();
  root_->_fireFrameStarted();
  target->update();
  root_->_fireFrameEnded();
  for (const auto& cloud : clouds_) {
    if (!cloud->error().empty()) throw std::runtime_error(cloud->error());
  }
}

}  // namespace rosplat
