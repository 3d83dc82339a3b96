#include "gpu/card_map.hpp"

#include <new>

#include "gl/driver.hpp"
#include "gl/object.hpp"
#include "gpu/slot_reader.hpp"

namespace rosplat {

void CardMap::apply(const std::shared_ptr<const GaussianEdit>& edit, double now) {
  try {
    store_.apply(*edit, now);
  } catch (...) {
    if (edit->clear) endLevels();  // of the map that is gone by now
    throw;
  }
  if (levels_) levels_->apply(store_, edit, now);
  ring_.close();
  gl::deleteAbandoned();
}

void CardMap::advanceLevels(double now) {
  if (levels_) makeLevels(now, false);
}

// Does some of the work on the levels or, with `all`, all of it.
void CardMap::makeLevels(double now, bool all) {
  if (!levels_error_.empty()) return;
  try {
    if (!levels_) levels_.emplace(ring_);
    levels_->advance(store_, now, all);
    ring_.close();
    levels_error_ = levels_->error();
  } catch (const gl::Error& error) {
    levels_error_ = error.what();
  } catch (const std::bad_alloc&) {
    levels_error_ = "there is no memory for levels of detail";
  }
  if (!levels_error_.empty()) endLevels();
}

void CardMap::dropLevels() {
  levels_error_.clear();
  endLevels();
}

void CardMap::endLevels() {
  if (!levels_) return;
  levels_.reset();
  store_.dropLevels();
}

void CardMap::forEachPage(const std::function<void(const GaussianEdit&)>& take) const {
  take(pages().moves());
  PageReader reader;
  for (std::size_t i = 0; i < pages().pages().size(); ++i) {
    if (store_.holds(pages().pages()[i])) take(editOf(reader.read(store_, i, 1)));
  }
}

CardMap::Chosen CardMap::chooseDetail(const std::string& view_id, const RenderSettings& settings,
                                      const SplatCamera& camera, bool ordered, double now) {
  const bool full = settings.drawnDetail() == Detail{};
  if (full || ordered) {
    forget(view_id);
    return {0, full ? "" : "a given order has no levels of detail"};
  }
  ViewDetail& view = views_[view_id];
  DetailControl& control = view.control;
  const bool at_once = !settings.interactive;
  view.chooses = false;
  if (at_once || !levels_) makeLevels(now, at_once);
  if (!levels_) return {0, levels_error_};
  view.chooses = true;
  if (at_once || !control.expects()) expect(control, settings, camera);
  return {control.choose(settings), ""};
}

void CardMap::expectDetail(const std::string& view_id, const RenderSettings& settings,
                           const SplatCamera& camera) {
  const auto found = views_.find(view_id);
  if (!levels_ || !settings.interactive || found == views_.end()) return;
  expect(found->second.control, settings, camera);
}

void CardMap::expect(DetailControl& control, const RenderSettings& settings,
                     const SplatCamera& camera) const {
  control.expect({levels_->samples(), camera, pages().groups(), settings});
}

std::optional<double> CardMap::adjustDetail(const std::string& view_id, double error,
                                            std::size_t drawn) {
  const auto found = views_.find(view_id);
  if (found == views_.end() || !found->second.chooses) return {};
  return found->second.control.adjust(error, drawn);
}

std::string CardMap::detailProblem(const std::string& view_id) const {
  const auto found = views_.find(view_id);
  const bool chooses = found != views_.end() && found->second.chooses;
  return chooses ? found->second.control.problem() : "";
}

void CardMap::forget(const std::string& view_id) {
  views_.erase(view_id);
  if (views_.empty()) dropLevels();
}

}  // namespace rosplat
