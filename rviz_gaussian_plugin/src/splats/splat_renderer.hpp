#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "gaussian_map.hpp"
#include "gl_objects.hpp"
#include "projection.hpp"
#include "radix_sort.hpp"
#include "render_settings.hpp"
#include "shaders.hpp"
#include "slot_store.hpp"
#include "splat_camera.hpp"
#include "tally.hpp"
#include "tile_rasterizer.hpp"

namespace rosplat {

// What the current framebuffer and viewport are to draw().
enum class Canvas {
  kWindow,   // the opaque scene; its first row is the picture's bottom
  kTexture,  // the same with the picture's top first
  kNone,     // nothing: there is no opaque scene, and the picture is only read back
};

// Draws the translucent objects of the scene into the current framebuffer and viewport.
using DrawTranslucent = std::function<void()>;

// Draws a map with OpenGL 4.4: what is visible is projected once a frame, then blended in a given
// order or in one found here, as quads or in tiles. Knows no Ogre; runs in the render thread only.
class SplatRenderer {
 public:
  // Throws gl::Error where the driver can't do it.
  explicit SplatRenderer(const ShaderSource& source);

  // Uploads what the edit changes; its slots are new from now on. Throws gl::Error when the driver
  // has no memory left.
  void apply(const GaussianEdit& edit);

  // Makes slots[0..count) what draw() draws, farthest first.
  void setOrder(const std::uint32_t* slots, std::size_t count);
  // Lets draw() sort what is visible itself, by the sorters' depth and with their ties.
  void sortByDepth();

  // Blends the splats of the order, hidden where the current framebuffer and viewport have
  // something nearer, into a target of its own; then over that viewport, which has the camera's
  // size. Where the scene has translucent objects, which come next, the splats are divided at the
  // nearest of them in each pixel, and only those behind it are laid over.
  void draw(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
            Canvas canvas, const DrawTranslucent& translucent = nullptr);
  // Lets the splats that a divided draw() has laid over hide what is translucent and farther, where
  // they are more opaque than not.
  void hideFarther() const;
  // Lays over the splats that a divided draw() has kept back, once the translucent objects are
  // drawn.
  void drawBefore() const;

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

  // The values of slots as they are drawn, positions relative to the map's origin.
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const;

  // The splats that draw() blended: width * height * 4 floats, premultiplied, top row first.
  std::vector<float> readColor() const;
  // Draws the mean depth of the splats as draw() saw them: width * height [m], NaN where nothing
  // is.
  std::vector<float> readDepth();

  // Whether a graphics card draws, not the processor.
  bool accelerated() const { return accelerated_; }
  std::size_t drawn() const { return drawn_count_; }
  const char* rasterizer() const { return rasterizer_; }  // of the last draw()
  // Of the last draw(), by stage [s]; empty unless settings.profile asked for it.
  const std::map<std::string, double>& profile() const { return profile_; }
  std::size_t mapBytes() const { return store_.bytes(); }
  std::size_t gpuBytes() const;

 private:
  struct Order {
    explicit Order(const Tallies& tallies) : tally(tallies.of(Tallies::kOrder)) {}

    bool given = false;
    gl::Buffer slots;  // farthest first
    std::size_t count = 0;
    Tally tally;  // the same
  };
  // What quads are drawn for.
  enum class Quads {
    kColour,
    kDepth,   // instead of colour [m]
    kBehind,  // colour and nearness, of what is behind translucent objects
  };
  // What the projected, ordered splats answer.
  struct Prepared {
    SplatCamera camera;
    RenderSettings settings;
    std::array<double, 3> origin{};
    bool antialiased = false;
  };

  void setTarget(gl::Target& target, GLenum format, const SplatCamera& camera,
                 const RenderSettings& settings, Canvas canvas);
  bool prepared(const SplatCamera& camera, const MapState& map,
                const RenderSettings& settings) const;
  // Submits what projects and sorts what is visible; false where that is there already.
  bool prepare(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
               gl::Stopwatch& stopwatch);
  // The same, and sees to it that there is room for all.
  void prepareAndCheck(const SplatCamera& camera, const MapState& map,
                       const RenderSettings& settings);
  // Whether there was room for all that prepare() and, in_tiles, its lists were to hold; else makes
  // it, or gives up tiles, and all has to be submitted again.
  bool checkRoom(const MapState& map, bool& in_tiles);
  void putInOrder();
  void divide();
  void divideQuads();
  void drawQuads(const gl::Target& target, const gl::Buffer& drawn, Quads what) const;
  void layOver(const gl::Program& program, GLuint framebuffer, const gl::Target& target, GLint x,
               GLint y) const;
  const Tally& drawnTally() const { return order_.given ? order_.tally : projection_.visible(); }
  double clock() const;  // of `change` in packed_slot.hpp

  bool accelerated_;
  Shaders shaders_;
  SlotStore store_;
  Tallies tallies_;
  Projection projection_;
  gl::Program order_program_;
  RadixSort sort_;
  TileRasterizer tiles_;
  gl::Program quads_, quads_behind_, divide_, tile_depth_, divide_quads_, composite_, hide_;
  gl::Program surface_, pick_, pick_colour_;

  Order order_{tallies_};
  std::optional<Prepared> prepared_;
  gl::Buffer drawn_;  // indices of ellipses, nearest first
  std::size_t drawn_count_ = 0;
  int key_bits_ = 32;       // by which depths are sorted
  int fewer_bits_for_ = 0;  // frames for which fewer would have done
  gl::Target color_, depth_, surface_depth_, pick_depth_;
  gl::SampledDepth translucent_;  // of the nearest translucent objects
  gl::Target behind_;       // the splats behind them, these splats' nearness; the scene's depth
  gl::Target tile_depths_;  // nearest and farthest depth that divides the splats in a tile
  gl::Buffer drawn_before_, drawn_behind_;  // like drawn_, kNone where a splat can't be seen there
  gl::Buffer picked_;                       // slots, of pick_depth_'s pixels
  Raster raster_;                           // of what was drawn last
  const char* rasterizer_ = "";
  std::map<std::string, double> profile_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace rosplat
