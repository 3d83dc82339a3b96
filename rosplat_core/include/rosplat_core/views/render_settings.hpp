#pragma once

#include <algorithm>
#include <array>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

// How values of a channel become colours.
enum class ChannelColours {
  kAuto,        // categories where all are integers
  kCategories,  // the nearest integers have colours that are easy to tell apart
  kGradient,
};

// Whether splats are solid.
inline bool drawsBalls(DrawMode mode) {
  return mode == DrawMode::kFlatBall || mode == DrawMode::kGaussianBall;
}

// Opacity compensation for the 2D low-pass filter (Mip-Splatting).
enum class Antialiasing { kAsTrained, kOn, kOff };

// Whose order is drawn.
enum class OrderSource { kAuto, kSidecar, kBuiltIn, kOff, kGpu };

// What blends the splats.
enum class Rasterizer {
  kAuto,       // tiles where a graphics card draws, else the processor
  kQuads,      // the fixed-function blending of quads, back to front
  kTiles,      // compute shaders, tile by tile, front to back
  kProcessor,  // the processor's own vector instructions
};

// What is kept of a map: splats with their mean in a box of the map's frame.
struct ClipBox {
  bool enabled = false;
  std::array<float, 3> centre{};       // [m]
  std::array<float, 3> size{1, 1, 1};  // [m]

  bool operator==(const ClipBox& o) const {
    return enabled == o.enabled && centre == o.centre && size == o.size;
  }
};

// How much of a map is drawn: see levels.hpp.
struct Detail {
  enum class Kind {
    kFull,    // all of it
    kError,   // what is no wider than so much may be one Gaussian [px]
    kSplats,  // so many Gaussians at most
  };
  Kind kind = Kind::kFull;
  double amount = 0;

  bool operator==(const Detail& o) const { return kind == o.kind && amount == o.amount; }
};

// How a map is drawn.
struct RenderSettings {
  DrawMode mode = DrawMode::kColor;
  int max_sh_degree = kMaxShDegree;
  int only_band = -1;  // draw one band of spherical harmonics alone; -1: all
  // In 32-bit floats instead of 16-bit ones: more exact ("Half floats" in docs/stability.md); quads
  // take two to five times as long. The processor always does.
  bool float_blending = false;
  // Nobody waits for a picture. The processor's follow the camera, and the newest is shown
  // meanwhile; a budget is come to by small steps.
  bool interactive = false;
  float scale = 1;    // of the splats' size
  float opacity = 1;  // of their opacity, 0 to 1
  Antialiasing antialiasing = Antialiasing::kAsTrained;
  OrderSource order = OrderSource::kAuto;
  Rasterizer rasterizer = Rasterizer::kAuto;
  bool profile = false;  // measure the stages of a frame; waits for the graphics card
  Detail detail;
  ClipBox clip_box;
  float near_fade = 0;                 // splats closer than this to the near plane fade out [m]
  std::array<float, 2> depth_range{};  // of kDepth [m]; empty: the nearest and farthest so drawn
  float age_range = 10;                // of kAge [s]
  std::string channel;                 // of kChannel; empty: the map's first
  ChannelColours channel_colours = ChannelColours::kAuto;
  std::array<float, 2> channel_range{};  // ends of a gradient; empty: all values that there were

  // Whether splats are projected alike.
  bool projectsAs(const RenderSettings& o) const {
    return mode == o.mode && max_sh_degree == o.max_sh_degree && only_band == o.only_band &&
           scale == o.scale && opacity == o.opacity && antialiasing == o.antialiasing &&
           clip_box == o.clip_box && near_fade == o.near_fade && age_range == o.age_range &&
           depth_range == o.depth_range && channel == o.channel &&
           channel_colours == o.channel_colours && channel_range == o.channel_range &&
           detail == o.detail && blendsLevels() == o.blendsLevels();
  }

  // Whether levels of detail blend into one another, lest they pop: solids can't, and the budget of
  // a picture that is waited for has better uses.
  bool blendsLevels() const {
    return !drawsBalls(mode) && (interactive || detail.kind != Detail::Kind::kSplats);
  }

  // Nodes have no values of channels: these are drawn in full.
  Detail drawnDetail() const { return mode == DrawMode::kChannel ? Detail{} : detail; }
};

// How many times as large as in the map splats are culled: SplatCamera::extent_scale.
inline double extentScale(const RenderSettings& settings) { return std::max(1.0f, settings.scale); }

// The same without what is for the eye's speed alone: for the mouse, and for pictures that are
// kept.
inline RenderSettings inFull(RenderSettings settings) {
  settings.interactive = false;
  settings.detail = {};
  return settings;
}

}  // namespace rosplat
