#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "egl_context.hpp"
#include "gl/readback.hpp"
#include "gl/shaders.hpp"
#include "gl/target.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"
#include "splat_renderer.hpp"

namespace rosplat {

// Pictures of maps and of opaque bodies that other code has drawn in the same context, as MuJoCo
// does: composed on the graphics card, and read once. Without a window, and without Ogre. In any
// thread: threads wait for one another.
class CardRenderer {
 public:
  // A map in the card's memory, which is in all pictures.
  struct Map {
    GaussianMap books;
    std::shared_ptr<CardMap> card;
    MapState state;  // as it is drawn
  };
  // Where a picture goes, top row first.
  struct Memory {
    std::uint8_t* colours;   // RGB
    std::uint8_t* surfaces;  // 1 where splats take half of the light or more, else 0
    float* depths;           // there, of the splat that leaves half or less; else of the body, inf
                             // where there is none [m]
  };

  // media: the folder of the shaders. Throws std::runtime_error with a sentence for the user.
  explicit CardRenderer(const std::string& media);
  ~CardRenderer();

  const std::shared_ptr<EglContext>& context() const { return context_; }
  const std::string& graphics() const { return graphics_; }
  // Adds an empty map, which lives as long as this.
  Map& addMap();
  BatchReport apply(Map& map, const GaussianBatch& batch);
  // What a camera sees. bodies: a framebuffer of the context, or 0, of the camera's size, its first
  // row the picture's bottom; of its window depths, 1 is the camera's near_clip and 0 its far_clip,
  // or nothing. Bodies hide the splats whose centres are behind them. Throws std::runtime_error.
  void draw(SplatCamera camera, GLuint bodies, const Memory& to);

  RenderSettings settings;

 private:
  void layBodies(const SplatCamera& camera, GLuint bodies);
  void read(const gl::Target& splats, const Memory& to);

  std::shared_ptr<EglContext> context_;
  std::string graphics_;
  std::optional<Shaders> shaders_;
  std::optional<SplatRenderer> renderer_;
  std::vector<std::unique_ptr<Map>> maps_;
  gl::Target canvas_;  // the picture; its second colour: depths of bodies [m]
  gl::Target bodies_;  // MuJoCo's picture
  std::optional<gl::Readback> readback_;
};

}  // namespace rosplat
