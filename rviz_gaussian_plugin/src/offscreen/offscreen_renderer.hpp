#pragma once

#include <OgreLogManager.h>
#include <OgreRoot.h>
#include <OgreTexture.h>

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "gl/program.hpp"
#include "rosplat_core/order/order_slots.hpp"
#include "splat_cloud.hpp"

namespace rosplat {

// Draws maps into a texture with an Ogre of its own, for programs without rviz. Needs an X display.
// One at a time in a process. Only on the thread that made it, except apply() and offer() of maps.
class OffscreenRenderer {
 public:
  // media: the folder of the shaders; plugins: the folder of Ogre's RenderSystem_GL.
  // Throws std::runtime_error with a sentence for the user.
  OffscreenRenderer(const std::string& media, const std::string& plugins);
  ~OffscreenRenderer();

  SplatScene& scene() const { return clouds_.front()->scene(); }
  // Adds a map, which is drawn together with that of scene(). It lives as long as the renderer.
  SplatScene& addMap();
  RenderSettings settings;   // of the next draw
  OrderReader order_reader;  // for one thread at a time

  void setCamera(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera);
  const SplatCamera& cameraOf(const std::string& view_id) const;
  // Draws all maps as a view's camera sees them; sort_now: sorts here, waits for no order. Reports
  // on scene(), but the splats of all maps. Throws std::runtime_error, as do the functions that
  // read a picture if there is none.
  FrameReport draw(const std::string& view_id, bool sort_now);

  // Puts a white box into the map's frame [m], which hides the splats behind it: opaque, or
  // translucent if opacity is below 1. A size of 0 removes the box.
  void setBox(const std::array<float, 3>& centre, const std::array<float, 3>& size, float opacity);

  std::vector<float> readColor() { return drawn().readColor(); }
  std::vector<float> readDepth();
  // The slot that each pixel of a rectangle of a view shows, kNoSlot where none does; of scene() as
  // drawn last.
  std::vector<std::uint32_t> pick(const std::string& view_id, int left, int top, int width,
                                  int height);
  // The whole picture, opaque objects included: width * height * 3, top row first.
  std::vector<std::uint8_t> readPicture(const std::array<float, 3>& background);

  int width() const { return texture_ ? int(texture_->getWidth()) : 0; }
  int height() const { return texture_ ? int(texture_->getHeight()) : 0; }
  const std::string& graphics() const { return graphics_; }
  // Whether OpenGL has reported an error since this was last asked.
  bool failed() const;

 private:
  SplatScene& drawn();
  void resize(int width, int height);
  void paintBackground();
  // Fills the picture with the background, by a shader.
  void clear() const;
  void update();

  std::unique_ptr<Ogre::LogManager> log_;
  std::unique_ptr<Ogre::Root> root_;
  Ogre::SceneManager* manager_ = nullptr;
  Ogre::Camera* camera_ = nullptr;
  Ogre::TexturePtr texture_;
  std::array<float, 3> background_{};
  std::optional<gl::Program> clear_;                 // unset without a graphics card
  std::vector<std::unique_ptr<SplatCloud>> clouds_;  // one for each map
  std::map<std::string, std::pair<std::uint64_t, SplatCamera>> cameras_;  // with their sequence
  std::string view_id_;
  bool drawn_ = false;   // whether the last draw() succeeded
  bool picked_ = false;  // whether pick() was called since
  std::string graphics_;
};

}  // namespace rosplat
