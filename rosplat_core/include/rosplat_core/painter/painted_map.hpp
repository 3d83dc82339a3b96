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

namespace rosplat {

// A map in the processor's memory, for a Painter. The painter takes the map's edits, and has levels
// of detail made while any view wants levels.
class PaintedMap {
 public:
  // Applies the oldest waiting edit; returns false if there is none to take. Called by any thread.
  using TakeEdit = std::function<bool(const Arrivals::Apply&)>;

  explicit PaintedMap(TakeEdit take_edit);

  // For any thread, down to slots(). now: the clock of `change` in packed_slot.hpp.

  // Takes a map over from another drawer: first page by page, then its state.
  void load(const GaussianEdit& page, double now);
  void load(const MapState& map);
  // Calls take() with edits that rebuild the map elsewhere: the group poses, then page by page.
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const;
  std::vector<SplatValues> read(const std::vector<std::uint32_t>& slots) const;
  MapState state() const;
  std::size_t bytes() const;  // without levels
  std::size_t levelsBytes() const { return levels_bytes_; }

  // To be held while a picture of the map is drawn.
  std::shared_lock<std::shared_mutex> lock() const { return std::shared_lock(slots_mutex_); }
  const HostSlots& slots() const { return slots_; }

  // The rest is for the painter's thread only.

  // Takes edits until none is left or `stop` is set; returns false if most_bytes ended it before.
  bool takeEdits(std::size_t most_bytes, const std::atomic<bool>& stop, double now);
  struct Chosen {
    bool settled = true;  // another picture would be in the same detail
    std::string error;    // why the picture isn't in the detail that was asked for
  };
  // Chooses the detail of a view's next picture: sets the layer's levels and error. Works on the
  // levels until stop(patience); patience: after how long a picture should do without [s].
  Chosen chooseDetail(const std::string& view_id, const std::function<bool(double)>& stop,
                      PictureLayer& layer);
  // Tells what the view's picture drew, and how long that took [s]. Returns the error [px] to
  // redraw with if the picture missed a budget that must hold at once.
  std::optional<double> adjustDetail(const std::string& view_id, const PictureLayer& layer,
                                     const SplatPicture::OfLayer& drawn, double seconds);
  // Why the view's last picture isn't in the detail that was asked for; empty if it is.
  std::string detailProblem(const std::string& view_id) const;
  // Drops what is known of the views that keep() denies; without any view left, drops the levels.
  void keepViews(const std::function<bool(const std::string& view_id)>& keep);
  // Works on wanted levels until stop(). Without memory, gives up until a view wants levels again.
  void goOnWithLevels(const std::function<bool()>& stop);

 private:
  void apply(const GaussianEdit& edit, const MapState& after, double now);
  void setState(const MapState& map);
  // Works on the levels until stop(); returns whether they are complete. Throws std::bad_alloc.
  bool advanceLevels(const std::function<bool()>& stop);
  void dropLevels();

  const TakeEdit take_edit_;

  // The state has a mutex of its own: showing a picture must never wait for the slots.
  mutable std::mutex state_mutex_;  // guards state_ and bytes_
  MapState state_;                  // of the slots
  std::size_t bytes_ = 0;

  mutable std::shared_mutex slots_mutex_;  // guards slots_; painting holds a shared lock
  HostSlots slots_;

  Levels levels_;
  std::map<std::string, DetailControl> controls_;  // of the views that aren't painted in full
  bool wants_levels_ = false;                      // any view does
  double seconds_in_full_ = 0;                     // duration of the last picture without levels
  std::atomic<std::size_t> levels_bytes_{0};
};
using PaintedMapPtr = std::shared_ptr<PaintedMap>;

}  // namespace rosplat
