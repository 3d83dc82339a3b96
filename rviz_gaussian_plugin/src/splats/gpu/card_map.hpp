#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "gpu/card_levels.hpp"
#include "gpu/slot_store.hpp"
#include "rosplat_core/levels/detail.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map in the graphics card's memory, to be drawn, with levels of detail while some view wants
// any. now: the clock of `change` in packed_slot.hpp.
class CardMap {
 public:
  // scatter: slot_scatter.comp; stays.
  explicit CardMap(const gl::Program& scatter) : store_(ring_, scatter) {}

  // Uploads what the edit changes; its slots are new from now on. Throws gl::Error when the driver
  // has no memory left.
  void apply(const std::shared_ptr<const GaussianEdit>& edit, double now);
  // Goes on with levels of detail, if there are some: even if none is drawn now.
  void advanceLevels(double now);

  // Has what is drawn from here on wait for what was uploaded, maybe in another context.
  void await() const { ring_.await(); }

  const SlotStore& store() const { return store_; }
  const SlotPages& pages() const { return store_.pages(); }
  // Those of levels of detail that are drawn by now; null where there are none.
  const NodeStore* nodes() const { return levels_ ? &levels_->nodes() : nullptr; }
  // What writes the map elsewhere: where its groups are, then a page of it at a time.
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const;

  // What a view's next picture draws where no order is given: nodes that are no wider than an error
  // in place of splats, 0 for none [px].
  struct Chosen {
    double error = 0;
    std::string problem;  // why that isn't the detail that was asked for
  };
  Chosen chooseDetail(const std::string& view_id, const RenderSettings& settings,
                      const SplatCamera& camera, double now);
  // How many of both it drew. If that missed a budget that is to be kept at once: the error to
  // which it has to be drawn again.
  std::optional<double> drew(const std::string& view_id, double error, std::size_t drawn);
  // Why a picture with levels isn't in the detail that was asked for; empty where it is.
  std::string detailProblem(const std::string& view_id) const;
  void forget(const std::string& view_id);

  std::size_t bytes() const { return store_.bytes(); }
  std::size_t levelsBytes() const { return levels_ ? levels_->bytes() : 0; }
  std::size_t gpuBytes() const {
    return store_.bytes() + ring_.bytes() + (levels_ ? levels_->gpuBytes() : 0);
  }

 private:
  // Of a view that isn't drawn in full.
  struct ViewDetail {
    DetailControl control;
    bool chooses = false;  // how that is drawn is up to the control
  };

  void makeLevels(double now, bool all);
  void dropLevels();
  void endLevels();

  gl::UploadRing ring_;
  SlotStore store_;
  std::optional<CardLevels> levels_;
  std::string levels_error_;  // why there are none although they were to be made
  std::map<std::string, ViewDetail> views_;
};

}  // namespace rosplat
