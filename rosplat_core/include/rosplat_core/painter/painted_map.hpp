#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <string>
#include <vector>

#include "rosplat_core/levels/detail.hpp"
#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/map/arrivals.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in the processor's memory, to be painted. Its painter takes its edits, and has levels of
// detail made of it while some view wants any.
class PaintedMap {
 public:
  // Has the oldest edit that waits applied; false where none is to be taken. Any thread.
  using TakeEdit = std::function<bool(const Arrivals::Apply&)>;

  explicit PaintedMap(TakeEdit take_edit);

  // All of these from any thread. now: the clock of `change` in packed_slot.hpp.

  // Begins with a map that another has drawn so far: its pages, and its state.
  void hold(const GaussianEdit& page, double now);
  void hold(const MapState& map);
  // What writes the map elsewhere: where its groups are, then a page of it at a time.
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const;
  std::vector<SplatValues> read(const std::vector<std::uint32_t>& slots) const;
  MapState state() const;
  std::size_t bytes() const;  // without levels
  std::size_t levelsBytes() const { return levels_bytes_; }

  // While a picture of it is drawn.
  std::shared_lock<std::shared_mutex> lock() const { return std::shared_lock(slots_mutex_); }
  const HostSlots& slots() const { return slots_; }

  // The rest is the painter's thread's alone.

  // Takes edits until they make up so many bytes, or until `stop` is set; whether none is left.
  bool takeEdits(std::size_t most_bytes, const std::atomic<bool>& stop, double now);
  // What of a view's next picture is to be drawn by nodes.
  struct Chosen {
    bool settled = true;  // another picture would be in the same detail
    std::string error;    // why it is not in the detail that was asked for
  };
  // stop: levels aren't to be waited for any longer, after so many seconds.
  Chosen chooseDetail(const std::string& view_id, const std::function<bool(double)>& stop,
                      PictureLayer& layer);
  // What became of it [s]. If that missed a budget that is to be kept at once: the error to which
  // it has to be drawn again.
  std::optional<double> drew(const std::string& view_id, const PictureLayer& layer,
                             const SplatPicture::OfLayer& drawn, double seconds);
  // Why a picture with levels isn't in the detail that was asked for; empty where it is.
  std::string detailProblem(const std::string& view_id) const;
  // Views that there are none of any more, or that don't want levels.
  void keepViews(const std::function<bool(const std::string& view_id)>& keep);
  // Goes on with levels until `stop`; where memory is lacking, not until a view wants them again.
  void goOnWithLevels(const std::function<bool()>& stop);

 private:
  void apply(const GaussianEdit& edit, const MapState& after, double now);
  void setState(const MapState& map);
  // Whether the levels hold all of the map. Throws std::bad_alloc.
  bool advanceLevels(const std::function<bool()>& stop);
  void dropLevels();

  const TakeEdit take_edit_;

  // Under a lock of its own: showing a picture must never wait for the slots.
  mutable std::mutex state_mutex_;  // what follows
  MapState state_;                  // of the slots
  std::size_t bytes_ = 0;

  mutable std::shared_mutex slots_mutex_;  // what follows; it is painted with a shared lock
  HostSlots slots_;

  Levels levels_;
  std::map<std::string, DetailControl> controls_;  // of views that aren't painted in full
  bool wants_levels_ = false;                      // some of these do
  double seconds_in_full_ = 0;                     // that the last picture without levels took
  std::atomic<std::size_t> levels_bytes_{0};
};
using PaintedMapPtr = std::shared_ptr<PaintedMap>;

}  // namespace rosplat
