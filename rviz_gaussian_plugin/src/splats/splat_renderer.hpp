#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <unordered_map>
#include <vector>

#include "gaussian_map.hpp"
#include "gl_objects.hpp"
#include "render_settings.hpp"
#include "splat_camera.hpp"

namespace rosplat {

// What the current framebuffer and viewport are to draw().
enum class Canvas {
  kWindow,   // the opaque scene; its first row is the picture's bottom
  kTexture,  // the same with the picture's top first
  kNone,     // nothing: there is no opaque scene, and the picture is only read back
};

// Draws a map with OpenGL 4.3: splats in storage buffers by slot, projected once a frame by a
// compute pass, then drawn as quads in a given order. Knows no Ogre; runs in the render thread
// only.
class SplatRenderer {
 public:
  // Reads a shader's source by file name.
  using ShaderSource = std::function<std::string(const std::string& name)>;

  // Throws gl::Error where the driver can't do it.
  explicit SplatRenderer(const ShaderSource& source);

  // Uploads what the edit changes; its slots are new from now on. Throws gl::Error when the driver
  // has no memory left.
  void apply(const GaussianEdit& edit);

  // Makes slots[0..count) what draw() draws, farthest first.
  void setOrder(const std::uint32_t* slots, std::size_t count);

  // Blends the splats of the order, hidden where the current framebuffer and viewport have
  // something nearer, into a target of its own; then over that viewport, which has the camera's
  // size.
  void draw(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
            Canvas canvas);

  // Writes where the splats' surface is, for rviz's mouse tools, into the current framebuffer and
  // viewport: mean depth / far_clip as 24-bit colour, lowest byte in blue.
  void drawSurface(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
                   Canvas canvas, double far_clip);

  // Finds the splat that contributes most to each pixel, at least a twentieth of its colour, among
  // those that the current framebuffer and viewport don't hide; then writes there the map's handle
  // for rviz's selection as 24-bit colour, or, without one, slot + 1 (slots of 24 bits only).
  void drawPick(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
                Canvas canvas, std::uint32_t handle);
  // What drawPick() found: width * height slots, top row first; kNoSlot where there is none.
  std::vector<std::uint32_t> readPick() const;

  // The values of slots as they are stored, positions relative to the map's origin.
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const;

  // The splats that draw() blended: width * height * 4 floats, premultiplied, top row first.
  std::vector<float> readColor() const;
  // Draws the mean depth of the splats as draw() saw them: width * height [m], NaN where nothing
  // is.
  std::vector<float> readDepth();

  std::size_t drawn() const { return order_count_; }
  std::size_t gpuBytes() const;

 private:
  struct Page {
    gl::Buffer geometry;
    std::array<gl::Buffer, kMaxShDegree + 1> bands;
  };

  Page& page(std::uint32_t index);
  void addBands(int degree);
  void reserveProjected();
  void begin(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
             Canvas canvas, gl::Target& target, GLenum format);
  void layOver(const gl::Program& program, GLuint framebuffer, const gl::Target& target, GLint x,
               GLint y) const;
  void project(const SplatCamera& camera, const MapState& map, const RenderSettings& settings);
  void drawQuads(const gl::Target& target, const RenderSettings& settings, bool raw_depth) const;
  float age() const;  // of the renderer [s]

  gl::Program project_, quads_, composite_, surface_, pick_, pick_colour_;
  std::size_t part_slots_ = 0;  // slots in one part of the projected buffer

  std::unordered_map<std::uint32_t, Page> pages_;  // by slot / kPageSlots
  int sh_degree_ = 0;
  std::uint32_t capacity_ = 0;
  std::vector<gl::Buffer> projected_;
  gl::Buffer order_;
  gl::Buffer depth_range_;  // nearest and farthest depth drawn, as float bits
  std::size_t order_count_ = 0;
  gl::Target color_, depth_, surface_depth_, pick_depth_;
  gl::Buffer opaque_depths_, picked_;  // of pick_depth_'s pixels
  bool top_first_ = false;             // the targets' first row is the picture's top
  RenderSettings drawn_settings_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace rosplat
