#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
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

// A map in a picture, and how it is drawn there.
struct PictureLayer {
  const HostSlots* slots = nullptr;
  const MapState* map = nullptr;
  SplatCamera camera;  // in the map's frame
  RenderSettings settings;
  // Nodes of the map to be drawn in place of what is smaller than `error`. Null: all is drawn in
  // full, as it is where the order is given, and for picks.
  const Levels* levels = nullptr;
  double error = 0;  // [px]
};

// What a picture shows. Arrays are the caller's, and by pixel, top row first.
struct PictureRequest {
  // At least one. Their cameras are one camera: all that differs is the frame that it is in, and
  // how large splats are. Splats of the same depth come in the order of the layers.
  std::vector<PictureLayer> layers;
  double now = 0;  // the clock of `change` in packed_slot.hpp
  // Window depth, 0 to 1, of what is opaque: splats behind it are hidden. Empty: nothing is there.
  ArrayView<float> scene_depth;
  // The same of the nearest translucent object, 1 where there is none. If given, the splats behind
  // it make a picture of their own.
  ArrayView<float> translucent_depth;
  // Slots of the one layer that there is then, farthest first, to be drawn in this order; what it
  // leaves out isn't drawn. Unset: by depth, with the sorters' ties.
  std::optional<ArrayView<std::uint32_t>> order;
  PictureDepth depth = PictureDepth::kNone;
  // Of contribute(): a number for each pixel that is dealt to the splats. Empty: none is.
  ArrayView<float> residual;
  // Set by another thread to have the picture given up.
  const std::atomic<bool>* cancelled = nullptr;
};

// Of width * height pixels, top row first. What wasn't asked for is empty.
struct SplatPicture {
  int width = 0, height = 0;    // [px]
  std::vector<float> colour;    // premultiplied RGBA
  std::vector<float> behind;    // the same behind translucent objects; colour is before them
  std::vector<float> nearness;  // of these: (1 - window depth) * alpha, alpha; as splat_hide.frag
  std::vector<std::uint8_t> divided;  // tiles that may have either; they are 0 in the others
  std::vector<float> depth;           // PictureDepth [m], NaN where there is none
  struct OfLayer {
    std::size_t drawn = 0;  // splats in the picture, as far as it was looked
    double error = 0;       // that it was drawn to, 0 in full [px]
  };
  std::vector<OfLayer> layers;
  std::map<std::string, double> profile;  // by stage [s]
};

// Transmittance below which splats may count as hidden where contributions are found.
constexpr float kLeastSeen = 0.01f;

// A splat that a pixel shows.
struct PickedSplat {
  std::uint32_t layer = 0, slot = kNoSlot;

  bool operator==(const PickedSplat& o) const { return layer == o.layer && slot == o.slot; }
};

// What the splats of the one layer are to pictures, by slot: sums over their pixels.
struct Contributions {
  std::vector<float> weight;  // of alpha x transmittance: of how many pixels a splat is the colour
  std::vector<float> energy;  // of the squares of these
  std::vector<float> error;   // of the squares by which red, green and blue change without it
  // Of weights times the request's residual; zeros where that has none.
  std::vector<float> residual;
};

// A picture that can't be drawn; the text says why.
struct PictureError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Draws maps with the processor alone, all of a picture in one depth order. What the shaders in
// ogre_media do is done here, too: projection, order, tiles of 16x16 pixels, front to back. The
// picture is the same to the bit for any number of threads. Keeps its workspace between pictures;
// one caller at a time.
class CpuRasterizer {
 public:
  // Vector instructions to use; what the machine doesn't have becomes the best that it has.
  enum class Instructions { kPlain, kAvx2, kAvx512, kBest };

  explicit CpuRasterizer(std::shared_ptr<ThreadTeam> team = ThreadTeam::ofViewers(),
                         Instructions instructions = Instructions::kBest);
  ~CpuRasterizer();

  // Draws into `picture`, whose memory is used again. False where it was cancelled: then the
  // picture is no good. Throws PictureError, or std::bad_alloc where there is no memory for its
  // text, and may be used on.
  bool draw(const PictureRequest& request, SplatPicture& picture);

  // The splat that contributes most to each pixel, at least kLeastPicked of its colour; of slot
  // kNoSlot where there is none. For a part of a picture crop() the cameras, and the depths. Empty
  // where it was cancelled. Throws PictureError.
  std::vector<PickedSplat> pick(const PictureRequest& request);

  // Adds what each slot of one layer contributes to a picture in colour, without translucent
  // objects; nothing where less than kLeastSeen of it is. False where it was cancelled. Throws
  // PictureError.
  bool contribute(const PictureRequest& request, Contributions& contributions);

  const char* instructions() const;  // in use
  std::size_t bytes() const;         // of the workspace

 private:
  struct Work;

  std::unique_ptr<Work> work_;
};

// The best vector instructions that this machine has, of those up to the wanted ones.
CpuRasterizer::Instructions available(CpuRasterizer::Instructions wanted);

// Values of 0 to 1 as bytes, rounded; what is beyond is clamped.
void toBytes(const float* values, std::size_t count, std::uint8_t* bytes);

}  // namespace rosplat
