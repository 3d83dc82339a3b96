#pragma once

// The inner loops of CpuRasterizer, compiled for several targets from one source. Plain types
// alone: see simd.hpp.

#include <cstddef>
#include <cstdint>

#include "rosplat_core/raster/picture_depth.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/views/group_view.hpp"
#include "rosplat_core/views/splat_settings.hpp"

namespace rosplat::cpu {

constexpr int kMostLanes = 16;            // of any target
constexpr int kMostAppearanceWords = 24;  // a multiple of four, which are read at a time
constexpr int kTilePixels = kTile * kTile;

// A Cut (levels/cut.hpp) in float32.
struct CutView {
  float focal, from, over_span;  // over_span: 1 / (to - from)
  bool orthographic;
};

// The camera for the first test of a slot, with the clip box and the cut. Its pose: as GroupView.
struct CullView : SortView {
  bool clip_to_box;
  float half_box[3];  // [m]
  CutView cut;
  // Of a lens's picture, or a face of it. The depths that count, for clips and order, are those
  // along the lens's own axis, given in the camera's frame; or distances.
  bool through_lens, by_distance;
  float axis[3];
  // Of a lens's picture: a splat may show where its angle to the axis is at most that of the
  // farthest pixel, with this cosine, and what its extent, so many times as large, subtends.
  bool in_cone;
  float cone, extent_scale;
};

// PictureLens for the kernels.
struct LensCurve {
  const float* cubics;  // null: a pinhole
  int parts;
  float end, parts_per_end;
};

// A slot that may be seen.
struct Candidate {
  std::uint32_t key;    // nearer slots have smaller keys
  std::uint32_t index;  // index of the page in Work::pages * kPageSlots + slot in the page
};

// A page of slots of a map, or of nodes of its levels.
struct PageSlots {
  const float* position[3];
  const float* extent;
  const GroupView* group;
  const std::uint32_t* appearances;  // as in HostSlots::Page
  int appearance_words;              // of each
  int bands[4];                      // where a band begins in an appearance; 0: there is none
  const float* channel;              // values of the channel that is drawn
  const float* parents;              // width of each slot's parent cell [m]; null: drawn in full
  float own_cell;                    // of nodes: width of their cells [m], else 0
  float opacity_unit;                // opacity of code 1
  std::uint32_t first_index;         // Candidate::index of the first slot
};

// The uniforms of splat_project.comp.
struct ProjectView : SplatSettings {
  float fx, fy, cx, cy, width, height;  // [px]
  float least_tangent[2], most_tangent[2];
  float near_clip;
  float ndc_scale, ndc_offset;
  float now;
  float channel_least, channel_most, channel_per_range;
  ChannelKind channel_colours;
  int sh_degree;
  bool orthographic;
  bool through_lens;  // splats beside and behind the camera count, too
  float between;      // how far from a pixel's centre the picture may be sampled: 0 or 0.5 [px]
  bool planes;        // ellipses have RayShapes that are planes
  LensCurve lens;
  Model model;
  CutView cut;
};

// The largest window depth where something may still be seen, by tile, and the maxima over 2x2,
// 4x4, ... tiles.
struct Pyramid {
  static constexpr int kMostLevels = 16;

  const float* open;
  std::int32_t begins[kMostLevels], widths[kMostLevels];  // of each level in `open`
  std::int32_t across, down;                              // tiles
};

// A splat in the picture, ready to be blended.
struct alignas(64) Record {
  float x, y;            // centre [px]
  float ux, uy, vx, vy;  // axes, scaled for the formula at kSquarings [1/px]
  float peak;            // log2(opacity) / kSquared
  float colour[3];
  float depth, window_depth;
  std::int16_t left, top, right, bottom;  // bounding box: [left, right) x [top, bottom) [px]
  std::uint32_t index;                    // as Candidate::index
  float share;  // share in a Cut, drawn with opacity 1 - (1 - alpha)^share; or a ball's, below 0
};
static_assert(sizeof(Record) == 64);

// What makes a record a conic (views/conic.hpp), in a picture that shows any. The response is that
// of the nearer one of ray and spot.
struct alignas(32) RayShape {
  float tilt_x, tilt_y;  // [1/px]; of an ellipse's plane, by which its depth grows [m/px]
  float nearness;        // for u^2 + v^2
  float spot_x, spot_y;  // [px], infinite where there is none
  // Of a splat that is beside or behind the camera, Record::x, y are the principal point: u, v and
  // 1 + tilt.d there. Else 0, 0 and 1.
  float u, v, along;
};
static_assert(sizeof(RayShape) == 32);

// Values of Record::share for solid balls, which are blended differently.
constexpr float kFlatBallShare = -1, kGaussianBallShare = -2;

// alpha = (2^(peak - u^2 - v^2))^kSquared, with u, v: a pixel's offset from the centre along axes.
constexpr int kSquarings = 4;
constexpr float kSquared = 1 << kSquarings;

// Which tiles a splat touches.
struct Footprint {
  static constexpr int kRows = 4;

  std::int16_t top, bottom;                // rows of tiles: [top, bottom)
  std::int16_t first[kRows], last[kRows];  // columns [first, last) in each of the first rows
  std::int16_t left, right;                // columns of all rows: [left, right)
  // Set only if there are more than kRows rows; as Outline in splat_tiles.glsl.
  float x, y, reach_y, half_width, lean, rightmost;
  float between;  // as ProjectView's
};

// Samples in place of a tile's pixels: kHalfTile at most of its left half, and from there on as
// many of its right half, each by y. What a ray's line meets behind the camera doesn't count.
constexpr int kHalfTile = kTilePixels / 2;
struct TileSamples {
  const float* x;  // from the tile's corner [px]; null: there are none
  const float* y;
  // Where those of each half's rows of pixels begin in it, and the end.
  std::uint16_t rows[2][kTile + 1];
};

// A splat in the list of a tile.
struct Listed {
  std::uint32_t key;
  std::uint32_t record;
};

// A tile's pixels, plane by plane, row by row.
struct alignas(64) TilePixels {
  float transmittance[kTilePixels];
  float colour[3][kTilePixels];
  float depth[kTilePixels];  // kMean: weighted sum; kMedian: the depth, once there is one
};

// A tile, and the splats in its list.
struct ListedTile {
  const Listed* listed;  // nearest first
  std::size_t count;
  const Record* records;
  const RayShape* shapes;  // one for each record; null: all are flat
  bool planes;             // of flat records, which shapes are
  TileSamples samples;     // in place of pixels, if any. Requires shapes
  int left, top;           // [px]
  const float* opaque;     // window depths of opaque objects, which hide splats behind; or null
};

struct BlendTile : ListedTile {
  float ends_at;         // a pixel ends at this transmittance
  TilePixels* pixels;    // splats before `divided`, or all splats if that is null
  TilePixels* behind;    // splats behind `divided`; the depth is of 1 - window depth
  const float* divided;  // window depths of translucent objects; or null
};

struct PickTile : ListedTile {
  float* transmittance;
  float* most;           // largest contribution so far
  std::uint32_t* index;  // Record::index of the splat that made it
};

// What a splat contributes to a picture: sums over its pixels, as in Contributions.
struct Contribution {
  float weight;    // of alpha x transmittance
  float energy;    // of (alpha x transmittance)^2
  float error;     // of squared changes of red, green and blue without the splat
  float residual;  // of alpha x transmittance x ContributeTile::residual
};

struct ContributeTile : ListedTile {
  float ends_at;          // as in BlendTile
  const float* residual;  // by pixel; or null
  TilePixels* pixels;     // colour: the part of the picture's that is still to come from behind
  Contribution* splats;   // output, one for each in the list
};

// A tile of a picture whose mean depths are to be found.
struct DepthTile {
  // From the tile's first pixel on:
  const float* colour;  // premultiplied RGBA
  const float* behind;  // the same of the splats behind translucent objects; or null
  float* depth;         // weighted sums, which become means
  std::size_t stride;   // from row to row [px]
  int width, height;    // [px]
  bool orthographic;
};

struct Kernels {
  const char* name;
  // Writes the slots of a page that may be seen; returns how many. candidates: room for all slots.
  std::size_t (*cull)(const CullView& view, const PageSlots& page, Candidate* candidates);
  // Removes from places the slots that no tile may show any more; returns the number left. numbers:
  // output, the former index in places of each slot left.
  std::size_t (*hide)(const CullView& view, const ProjectView& project_view, const Pyramid& pyramid,
                      const PageSlots& page, std::uint16_t* places, std::uint16_t* numbers,
                      std::size_t count);
  // Projects the slots at some places of a page; returns how many are in the picture. kept: output,
  // the index in places of each of these. places must have room to read kMostLanes more. shapes:
  // output, one for each record; or null, if the model is EWA.
  std::size_t (*project)(const ProjectView& view, const PageSlots& page,
                         const std::uint16_t* places, std::size_t count, Record* records,
                         RayShape* shapes, Footprint* footprints, std::uint16_t* kept);
  // Blends the list until nothing behind can be seen; returns whether that is so at the end.
  bool (*blend)(const BlendTile& tile, PictureDepth depth);
  bool (*pick)(const PickTile& tile);
  bool (*contribute)(const ContributeTile& tile);
  // Divides the sums by the alphas; NaN where there is nothing.
  DepthSums (*findDepths)(const DepthTile& tile);
  // Converts values of 0 to 1, rounded; clamps values beyond.
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
