#pragma once

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <string>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/views/splat_settings.hpp"

namespace rosplat {

// How values of a channel become colours.
enum class ChannelColours {
  kAuto,        // categories if all values are integers, else a gradient
  kCategories,  // rounded to integers, each in a colour that is easy to tell from others
  kGradient,
};

// Whether splats are drawn as solid balls.
inline bool drawsBalls(DrawMode mode) {
  return mode == DrawMode::kFlatBall || mode == DrawMode::kGaussianBall;
}

// Which sorter's order is drawn.
enum class OrderSource {
  kAuto,     // the rasterizer's, which sorts each picture
  kSidecar,  // a sorter's, while it is of the map as it is and young; else the rasterizer's
  kOff,      // nobody's: by slots
};

// How the splats are blended.
enum class Rasterizer {
  kAuto,       // kTiles if there is a graphics card that can, else kProcessor
  kTiles,      // compute shaders, tile by tile, front to back
  kProcessor,  // the processor's own vector instructions
};

// Only splats whose mean lies in this box, in the map's frame, are drawn.
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
    kError,   // one Gaussian may stand for all in a cell of at most `amount` width [px]
    kSplats,  // at most `amount` Gaussians
  };
  Kind kind = Kind::kFull;
  double amount = 0;

  bool operator==(const Detail& o) const { return kind == o.kind && amount == o.amount; }
};

// How a map is drawn.
struct RenderSettings : SplatSettings {
  int max_sh_degree = kMaxShDegree;
  // Nobody waits for a picture: the processor paints after the camera, and the newest picture is
  // shown meanwhile. The level of detail approaches a budget in small steps.
  bool interactive = false;
  // Depths will be read: the card finds them with the picture, not later.
  bool depths = false;
  std::optional<Model> model;  // in place of the map's own
  OrderSource order = OrderSource::kAuto;
  Rasterizer rasterizer = Rasterizer::kAuto;
  bool profile = false;  // measure the stages of a frame; this waits for the graphics card
  Detail detail;
  ClipBox clip_box;
  std::string channel;  // of kChannel; empty: the map's first
  ChannelColours channel_colours = ChannelColours::kAuto;
  std::array<float, 2> channel_range{};  // ends of a gradient; empty: all values so far

  // Whether the projected splats are the same with both settings.
  bool projectsAs(const RenderSettings& o) const {
    return sameSplats(o) && max_sh_degree == o.max_sh_degree && model == o.model &&
           clip_box == o.clip_box && channel == o.channel && channel_colours == o.channel_colours &&
           channel_range == o.channel_range && detail == o.detail &&
           blendsLevels() == o.blendsLevels();
  }

  // Whether levels of detail blend into one another, lest they pop. Solid balls can't blend, and a
  // picture that is waited for spends its budget better.
  bool blendsLevels() const {
    return !drawsBalls(mode) && (interactive || detail.kind != Detail::Kind::kSplats);
  }

  // The model by which a map is drawn that was published with one.
  Model drawnModel(Model published) const { return model.value_or(published); }

  // Whether all SplatSettings, which have no padding, are the same.
  bool sameSplats(const SplatSettings& o) const {
    return std::memcmp(static_cast<const SplatSettings*>(this), &o, sizeof(o)) == 0;
  }

  // Nodes have no values of channels, so kChannel is drawn in full.
  Detail drawnDetail() const { return mode == DrawMode::kChannel ? Detail{} : detail; }
};

// Returns the settings' SplatCamera::extent_scale: the factor on the splats' extents in culling.
inline double extentScale(const RenderSettings& settings) { return std::max(1.0f, settings.scale); }

// Returns the settings without what only serves speed: for the mouse, and for pictures to be kept.
inline RenderSettings inFull(RenderSettings settings) {
  settings.interactive = false;
  settings.detail = {};
  return settings;
}

}  // namespace rosplat
