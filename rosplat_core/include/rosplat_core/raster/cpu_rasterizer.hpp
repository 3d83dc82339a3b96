#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/raster/picture_depth.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/threads/thread_team.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in a picture, and how the picture draws the map.
struct PictureLayer {
  const HostSlots* slots = nullptr;
  const MapState* map = nullptr;
  SplatCamera camera;  // in the map's frame
  RenderSettings settings;
  // Levels of detail: a node is drawn in place of splats whose cell is smaller than `error`. Null:
  // the map is drawn in full. Must be null for picks, and where `PictureRequest::order` is set.
  const Levels* levels = nullptr;
  double error = 0;  // [px]
};

// Places in a picture that are seen in place of its pixels: the pixels of a lens, where their rays
// pierce a face of a cube around the camera. Each is seen along its own ray, so that the faces have
// no seams. What a ray's line meets behind the camera doesn't count.
struct PictureSamples {
  // Of the samples of each tile's left half and of its right half, row by row of tiles; and the
  // end.
  ArrayView<std::uint32_t> begins;
  ArrayView<float> x, y;  // sorted by half of a tile, and there by y [px]
  // The lens's own axis in the face's frame: depths along it decide on clips and order. Unset, for
  // a lens that sees behind itself: distances do.
  std::optional<std::array<float, 3>> axis;
};

// A lens that is symmetric about its axis, the camera's z: what is in the direction n of length 1
// is imaged at (cx + fx g n.x, cy + fy g n.y), where g depends on w = (1 - n.z) / 2 alone. That is
// 0 ahead, and 1 behind.
struct PictureLens {
  ArrayView<float> curve;  // g in equal parts of w from 0 to `end`: by part, the four coefficients
                           // of a cubic in 0 to 1, the constant first
  float end = 0;           // splats beyond it are not imaged
  float widest = 0;        // w of the pixel farthest from the axis
  bool by_distance = false;  // clips and order are by distances, not by depths along the axis
};

// What a picture shows. The caller owns the arrays. Arrays by pixel begin with the top row.
struct PictureRequest {
  // At least one layer. All layers have the same camera: only the frame that the camera is given in
  // and its extent_scale may differ. Splats of equal depth are drawn in the order of the layers.
  std::vector<PictureLayer> layers;
  double now = 0;  // the clock of `change` in packed_slot.hpp
  // Window depths, 0 to 1, of opaque objects, which hide the splats behind them. Empty: no objects.
  ArrayView<float> scene_depth;
  // Window depths of the nearest translucent objects, 1 where there is none. If given, the splats
  // behind these objects go to a picture of their own, `SplatPicture::behind`.
  ArrayView<float> translucent_depth;
  // The slots to draw, farthest first; requires exactly one layer. Other slots aren't drawn. Unset:
  // all slots, by depth; ties are broken as by the sorters (DepthOrder).
  std::optional<ArrayView<std::uint32_t>> order;
  PictureDepth depth = PictureDepth::kNone;
  // Whether depths are those of the plane of each ellipse, on which its density is largest along a
  // ray, not of its centre. For pictures of EWA maps alone; in others nothing changes.
  bool planes = false;
  // If set, colours and depths are by sample, in their order. For draw() of maps whose model is Ray
  // or Disc, without objects.
  std::optional<PictureSamples> samples;
  // If set, the picture is the lens's, each splat projected by the lens's own Jacobian. For maps
  // whose model is EWA, without objects; not with `samples`.
  std::optional<PictureLens> lens;
  // For contribute(): numbers by pixel, to be shared out to the pixel's splats. May be empty.
  ArrayView<float> residual;
  // Another thread sets this to cancel the picture.
  const std::atomic<bool>* cancelled = nullptr;

  const SplatCamera& camera() const { return layers.front().camera; }
};

// Arrays of width * height pixels, top row first. Arrays that weren't asked for are empty.
struct SplatPicture {
  int width = 0, height = 0;    // [px]
  std::vector<float> colour;    // premultiplied RGBA
  std::vector<float> behind;    // the splats behind translucent objects; `colour` lacks them then
  std::vector<float> nearness;  // of `behind`: (1 - window depth) * alpha, alpha: splat_hide.frag
  std::vector<std::uint8_t> divided;  // tiles where `behind` and `nearness` may not be all 0
  std::vector<float> depth;           // PictureDepth [m], NaN where there is none
  std::vector<DepthSums> tiles;       // of kTile x kTile pixels, row by row; for kMean
  struct OfLayer {
    std::size_t drawn = 0;  // projected splats and nodes; hidden ones may have been skipped before
    double error = 0;       // PictureLayer::error of the levels of detail, 0 if drawn in full [px]
  };
  std::vector<OfLayer> layers;
  std::map<std::string, double> profile;  // by stage [s]
};

// Transmittance below which contribute() may count splats as hidden.
constexpr float kLeastSeen = 0.01f;

// A splat that a pixel shows.
struct PickedSplat {
  std::uint32_t layer = 0, slot = kNoSlot;

  bool operator==(const PickedSplat& o) const { return layer == o.layer && slot == o.slot; }
};

// What the splats of one layer contribute to pictures: sums over their pixels, by slot.
struct Contributions {
  std::vector<float> weight;    // of alpha x transmittance: how many pixels the splat fills
  std::vector<float> energy;    // of (alpha x transmittance)^2
  std::vector<float> error;     // of squared changes of red, green and blue without the splat
  std::vector<float> residual;  // of alpha x transmittance x PictureRequest::residual, 0 without
};

// A picture that can't be drawn; the text says why.
struct PictureError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Draws maps with the processor alone; all layers of a picture share one depth order. The steps are
// those of the shaders in ogre_media: projection, sorting, blending of 16x16 pixel tiles front to
// back. Pictures are the same to the bit for any number of threads. Keeps its workspace between
// pictures; one caller at a time.
class CpuRasterizer {
 public:
  // Vector instructions to use. A machine without them uses the best below them that it has.
  enum class Instructions { kPlain, kAvx2, kAvx512, kBest };

  explicit CpuRasterizer(std::shared_ptr<ThreadTeam> team = ThreadTeam::ofViewers(),
                         Instructions instructions = Instructions::kBest);
  ~CpuRasterizer();

  // Draws into `picture` and reuses its memory. Returns false if cancelled: the picture is invalid
  // then. Throws PictureError, or std::bad_alloc if even the error's text finds no memory; the
  // rasterizer stays usable.
  bool draw(const PictureRequest& request, SplatPicture& picture);

  // Returns the splat that contributes most to each pixel; its slot is kNoSlot where no splat
  // contributes kLeastPicked or more. For a part of a picture crop() the cameras and the depths.
  // Returns an empty vector if cancelled. Throws PictureError.
  std::vector<PickedSplat> pick(const PictureRequest& request);

  // Adds what each slot of the one layer contributes to a picture in DrawMode::kColor without
  // translucent objects. Behind a transmittance below kLeastSeen it may add nothing. Returns false
  // if cancelled. Throws PictureError.
  bool contribute(const PictureRequest& request, Contributions& contributions);

  const char* instructions() const;  // in use
  std::size_t bytes() const;         // of the workspace

 private:
  struct Work;

  std::unique_ptr<Work> work_;
};

// Returns the best vector instructions that this machine has, at most the wanted ones.
CpuRasterizer::Instructions available(CpuRasterizer::Instructions wanted);

// Converts values of 0 to 1 to bytes of 0 to 255, rounded. Clamps values beyond.
void toBytes(const float* values, std::size_t count, std::uint8_t* bytes);

}  // namespace rosplat
