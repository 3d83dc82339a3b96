#pragma once

// The loops that a picture spends its time in, compiled for several targets from one source; plain
// types alone, see simd.hpp.

#include <cstddef>
#include <cstdint>

#include "rosplat_core/raster/picture_depth.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/views/group_view.hpp"

namespace rosplat::cpu {

constexpr int kMostLanes = 16;  // of any target
constexpr int kTilePixels = kTile * kTile;

// A Cut.
struct CutView {
  float focal, from, over_span;  // over_span: 1 / (to - from)
  bool orthographic;
};

// What a slot is tested with before anything else: SortView, and a box.
struct CullView {
  float fx, fy, offset_x, offset_y, half_width, half_height, slope_x, slope_y;
  float near_clip, far_clip;
  bool orthographic;
  bool clip_to_box;
  float half_box[3];  // [m]
  CutView cut;
};

// A slot that may be seen.
struct Candidate {
  std::uint32_t key;    // the smaller, the nearer
  std::uint32_t index;  // of its page in the order of pages, times slots of a page, and in that
};

// A page of HostSlots, or of nodes.
struct PageSlots {
  const float* position[3];
  const float* extent;
  const GroupView* group;
  const std::uint32_t* words;     // 3 to 8, all slots of each
  const std::uint32_t* bands[4];  // by coefficient, all slots of each
  const float* channel;           // values of the one that is drawn
  const float* parents;           // widths of cells, or null where all is drawn in full [m]
  float own_cell;                 // of nodes: how wide their cells are [m], else 0
  float opacity_unit;
  std::uint32_t first_index;  // Candidate::index of its first slot
};

// The uniforms of splat_project.comp.
struct ProjectView {
  float fx, fy, cx, cy, width, height;  // [px]
  float least_tangent[2], most_tangent[2];
  float near_clip, near_fade;
  float ndc_scale, ndc_offset;
  float scale_modifier, opacity_modifier, now, age_range;
  float depth_range[2];
  float channel_least, channel_most, channel_per_range;
  ChannelKind channel_colours;
  DrawMode mode;
  int sh_degree, only_band;
  bool orthographic, antialiased;
  CutView cut;
};

// Up to which window depth something may still be seen, tile by tile, and the most of that in 2x2,
// 4x4, ... tiles.
struct Pyramid {
  static constexpr int kMostLevels = 16;

  const float* open;
  std::int32_t begins[kMostLevels], widths[kMostLevels];  // of the levels in `open`
  std::int32_t across, down;                              // tiles
};

// A splat in the picture, ready to be blended.
struct alignas(64) Record {
  float x, y;            // centre [px]
  float ux, uy, vx, vy;  // axes over kExponent of them [1/px]
  float peak;            // log2 of the opacity, over kSquared
  float colour[3];
  float depth, window_depth;
  std::int16_t left, top, right, bottom;  // pixels around it, the last two beyond it
  std::uint32_t index;                    // as Candidate::index
  float share;  // of it that is drawn: 1 - (1 - alpha)^share; or below 0, a solid ball
};
static_assert(sizeof(Record) == 64);

// Shares of solid balls, which differ from splats pixel by pixel.
constexpr float kFlatBallShare = -1, kGaussianBallShare = -2;

// alpha = (2^(peak - u^2 - v^2))^kSquared
constexpr int kSquarings = 4;
constexpr float kSquared = 1 << kSquarings;

// Which tiles a splat touches.
struct Footprint {
  static constexpr int kRows = 4;

  std::int16_t top, bottom;                          // rows, the last one beyond it
  std::int16_t first[kRows], last[kRows];            // columns in the first of these rows, or...
  std::int16_t left, right;                          // ...in all, and where...
  float x, y, reach_y, half_width, lean, rightmost;  // ...as in Outline of splat_tiles.glsl
};

// A splat of a tile.
struct Listed {
  std::uint32_t key;
  std::uint32_t record;
};

// A tile's pixels, plane by plane, row by row.
struct alignas(64) TilePixels {
  float transmittance[kTilePixels];
  float colour[3][kTilePixels];
  float depth[kTilePixels];  // weighted sum; of a median the depth, 0 where there is none so far
};

// A tile, and what is listed with it.
struct ListedTile {
  const Listed* listed;  // nearest first
  std::size_t count;
  const Record* records;
  int left, top;        // [px]
  const float* opaque;  // window depth that hides what is farther; or null
};

struct BlendTile : ListedTile {
  float ends_at;         // transmittance that counts as none
  TilePixels* pixels;    // of what is nearer than `divided`, if that is given
  TilePixels* behind;    // of the others; its depth is 1 - window depth
  const float* divided;  // of translucent objects; or null
};

struct PickTile : ListedTile {
  float* transmittance;
  float* most;           // contribution so far
  std::uint32_t* index;  // that it is from
};

// What a splat is to a picture: sums over its pixels.
struct Contribution {
  float weight;    // of alpha x transmittance: of how many pixels it is the colour
  float energy;    // of the squares of these
  float error;     // of the squares by which red, green and blue change without it
  float residual;  // of weights times ContributeTile::residual
};

struct ContributeTile : ListedTile {
  float ends_at;          // as BlendTile
  const float* residual;  // or null
  TilePixels* pixels;     // their colour: what is still to come of the picture's
  Contribution* splats;   // of the listed, one for each
};

struct Kernels {
  const char* name;
  // Writes the slots of a page that may be seen; returns how many.
  std::size_t (*cull)(const CullView& view, const PageSlots& page, Candidate* candidates);
  // Leaves those slots of a page that tiles may still show, and their numbers so far; returns how
  // many.
  std::size_t (*hide)(const CullView& view, const ProjectView& project_view, const Pyramid& pyramid,
                      const PageSlots& page, std::uint16_t* places, std::uint16_t* numbers,
                      std::size_t count);
  // Projects slots of a page, by their places in it (beyond them kMostLanes may be read); returns
  // how many are in the picture. kept: the number of each that is.
  std::size_t (*project)(const ProjectView& view, const PageSlots& page,
                         const std::uint16_t* places, std::size_t count, Record* records,
                         Footprint* footprints, std::uint16_t* kept);
  // Blends until nothing behind can be seen; returns whether that is so.
  bool (*blend)(const BlendTile& tile, PictureDepth depth);
  bool (*pick)(const PickTile& tile);
  bool (*contribute)(const ContributeTile& tile);
  // Of 0 to 1, rounded; what is beyond is clamped.
  void (*toBytes)(const float* from, std::size_t count, std::uint8_t* bytes);
};

namespace plain {
extern const Kernels kKernels;
}
namespace avx2 {
extern const Kernels kKernels;
}
namespace avx512 {
extern const Kernels kKernels;
}

}  // namespace rosplat::cpu
