#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "gl/program.hpp"
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
  // scatter: slot_scatter.comp; must outlive this.
  explicit CardMap(const gl::Program& scatter) : store_(ring_, scatter) {}

  // Uploads what the edit changes; the age of its slots counts from `now`. Throws gl::Error when
  // the driver has no memory left.
  void apply(const std::shared_ptr<const GaussianEdit>& edit, double now);
  // Does some work on the levels of detail, if there are any, even if no view draws.
  void advanceLevels(double now);

  // Makes later drawing wait for all uploads, which may be of another context.
  void await() const { ring_.await(); }

  const SlotStore& store() const { return store_; }
  const SlotPages& pages() const { return store_.pages(); }
  // The nodes of the levels of detail that are drawn; null without levels.
  const NodeStore* nodes() const { return levels_ ? &levels_->nodes() : nullptr; }
  // Calls take() with edits that rebuild the map elsewhere: its group poses, then page by page.
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const;

  // The detail of a view's next picture: nodes that are no wider than `error` [px] are drawn in
  // place of splats; 0: no nodes.
  struct Chosen {
    double error = 0;
    std::string problem;  // why that isn't the detail that was asked for
  };
  // ordered: the order is given, which nodes are not in.
  Chosen chooseDetail(const std::string& view_id, const RenderSettings& settings,
                      const SplatCamera& camera, bool ordered, double now);
  // Prepares the choice for the picture after this one, if that is interactive. It takes 0.1 to
  // 0.2 ms, and pictures that nobody waits for don't wait for it: call it while the card draws.
  void expectDetail(const std::string& view_id, const RenderSettings& settings,
                    const SplatCamera& camera);
  // Tells how many splats and nodes the view drew. Returns the error [px] to redraw with if that
  // missed a budget that must hold at once.
  std::optional<double> adjustDetail(const std::string& view_id, double error, std::size_t drawn);
  // Why a picture with levels isn't in the detail that was asked for; empty where it is.
  std::string detailProblem(const std::string& view_id) const;
  void forget(const std::string& view_id);

  std::size_t bytes() const { return store_.bytes(); }
  std::size_t levelsBytes() const { return levels_ ? levels_->bytes() : 0; }
  std::size_t gpuBytes() const {
    return store_.bytes() + ring_.bytes() + (levels_ ? levels_->gpuBytes() : 0);
  }

 private:
  // The detail of a view that isn't drawn in full.
  struct ViewDetail {
    DetailControl control;
    bool chooses = false;  // whether `control` chose the detail of the last picture
  };

  void expect(DetailControl& control, const RenderSettings& settings,
              const SplatCamera& camera) const;
  void makeLevels(double now, bool all);
  void dropLevels();
  void endLevels();

  gl::UploadRing ring_;
  SlotStore store_;
  std::optional<CardLevels> levels_;
  std::string levels_error_;  // why making levels failed; empty if it didn't
  std::map<std::string, ViewDetail> views_;
};

}  // namespace rosplat
