#include "rosplat_core/painter/painted_map.hpp"

#include <algorithm>
#include <iterator>
#include <new>
#include <utility>

namespace rosplat {

namespace {

// A picture waits for unfinished levels of detail for the longer of two times, then does without.
constexpr double kLevelsPerPicture = 0.03;  // [s]
constexpr double kLevelsShare = 0.5;        // of the time that the last picture without levels took

}  // namespace

PaintedMap::PaintedMap(TakeEdit take_edit)
    : take_edit_(std::move(take_edit)), levels_(ThreadTeam::ofViewers()) {}

void PaintedMap::load(const GaussianEdit& page, double now) {
  const std::unique_lock lock(slots_mutex_);
  slots_.apply(page, now);
}

void PaintedMap::load(const MapState& map) { setState(map); }

void PaintedMap::setState(const MapState& map) {
  MapState fresh = map;
  const std::size_t bytes = slots_.bytes();  // without a lock: only writers of slots_ come here
  const std::lock_guard lock(state_mutex_);
  state_ = std::move(fresh);
  bytes_ = bytes;
}

void PaintedMap::forEachPage(const std::function<void(const GaussianEdit&)>& take) const {
  const std::shared_lock lock(slots_mutex_);
  take(slots_.index().moves());
  for (const SlotPage& page : slots_.pages()) take(slots_.edit(page));
}

std::vector<SplatValues> PaintedMap::read(const std::vector<std::uint32_t>& slots) const {
  const std::shared_lock lock(slots_mutex_);
  return slots_.read(slots);
}

MapState PaintedMap::state() const {
  const std::lock_guard lock(state_mutex_);
  return state_;
}

std::size_t PaintedMap::bytes() const {
  const std::lock_guard lock(state_mutex_);
  return bytes_;
}

bool PaintedMap::takeEdits(std::size_t most_bytes, const std::atomic<bool>& stop, double now) {
  std::size_t taken = 0;
  const auto take = [&](const EditQueue::Waiting& arrival) {
    apply(*arrival.edit, arrival.state, now);
    taken += uploadBytes(*arrival.edit);
  };
  while (taken < most_bytes && !stop && take_edit_(take)) {
  }
  return taken < most_bytes;
}

void PaintedMap::apply(const GaussianEdit& edit, const MapState& after, double now) {
  const std::unique_lock lock(slots_mutex_);
  try {
    if (edit.clear) levels_.clear();
    slots_.apply(edit, now);
    levels_.mark(slots_, edit.runs);
    setState(after);
  } catch (...) {
    const std::lock_guard state_lock(state_mutex_);
    state_.torn = true;
    throw;
  }
}

void PaintedMap::goOnWithLevels(const std::function<bool()>& stop) {
  if (!wants_levels_) return;
  try {
    advanceLevels(stop);
  } catch (const std::bad_alloc&) {
    wants_levels_ = false;
  }
}

bool PaintedMap::advanceLevels(const std::function<bool()>& stop) {
  // Needs no lock: no other thread writes slots_, or reads the parents that this writes.
  const bool whole = levels_.advance(slots_, stop);
  levels_bytes_ = levels_.bytes();
  return whole;
}

void PaintedMap::keepViews(const std::function<bool(const std::string& view_id)>& keep) {
  for (auto control = controls_.begin(); control != controls_.end();) {
    control = keep(control->first) ? std::next(control) : controls_.erase(control);
  }
  if (controls_.empty()) dropLevels();
}

void PaintedMap::dropLevels() {
  wants_levels_ = false;
  levels_bytes_ = 0;
  if (!levels_.begun()) return;
  levels_.clear();
  const std::unique_lock lock(slots_mutex_);
  slots_.dropParents();
}

PaintedMap::Chosen PaintedMap::chooseDetail(const std::string& view_id,
                                            const std::function<bool(double)>& stop,
                                            PictureLayer& layer) {
  DetailControl& control = controls_[view_id];
  wants_levels_ = true;
  const double patience = std::max(kLevelsPerPicture, kLevelsShare * seconds_in_full_);
  try {
    const bool whole = advanceLevels([&] { return stop(patience); });
    if (levels_.nodes() == 0) return {whole, ""};  // drawn in full until there are nodes
    layer.levels = &levels_;
    control.expect({levels_.samples(), layer.camera, slots_.index().groups(), layer.settings});
    layer.error = control.choose(layer.settings);
    return {whole && control.settled(), ""};
  } catch (const std::bad_alloc&) {
    return {true, "there is no memory for levels of detail"};
  }
}

std::string PaintedMap::detailProblem(const std::string& view_id) const {
  const auto found = controls_.find(view_id);
  return found == controls_.end() ? "" : found->second.problem();
}

std::optional<double> PaintedMap::adjustDetail(const std::string& view_id,
                                               const PictureLayer& layer,
                                               const SplatPicture::OfLayer& drawn, double seconds) {
  const auto found = controls_.find(view_id);
  if (found == controls_.end()) return {};
  if (layer.levels) return found->second.adjust(drawn.error, drawn.drawn);
  seconds_in_full_ = seconds;
  return {};
}

}  // namespace rosplat
