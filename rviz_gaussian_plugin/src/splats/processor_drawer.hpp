#pragma once

#include <memory>
#include <string>
#include <vector>

#include "drawer.hpp"
#include "rosplat_core/map/arrivals.hpp"
#include "software_renderer.hpp"

namespace rosplat {

// A map in the processor's memory. The painter's thread takes the edits and paints, while the
// render thread shows the newest finished picture.
class ProcessorDrawer : public Drawer {
 public:
  ProcessorDrawer(std::shared_ptr<SoftwareRenderer> renderer, const Arrivals::Taker& taker);
  ~ProcessorDrawer() override { painter().remove(painted_); }

  DrawnBy by() const override { return DrawnBy::kProcessor; }

  MapState update(bool all) override;
  MapState map() const override { return painted_->state(); }
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const override {
    painted_->forEachPage(take);
  }
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const override {
    return painted_->read(slots);
  }

  bool drawsWith(const Drawer& other) const override;
  void request(const Picture& picture) override { renderer_->request(painted(picture)); }
  bool ready(const Picture& picture) const override { return renderer_->ready(painted(picture)); }
  std::vector<FrameReport> draw(const Picture& picture, Canvas canvas,
                                const Surroundings& around) override;
  void hideFarther(const std::string&) const override { renderer_->hideFarther(); }
  void drawBefore(const std::string&) const override { renderer_->drawBefore(); }
  void drawSurface(const Picture& picture, Canvas canvas, double far_clip) override {
    renderer_->drawSurface(painted(picture), canvas, far_clip);
  }
  void drawPick(const Picture& picture, Canvas canvas, std::uint32_t number) override {
    renderer_->drawPick(painted(picture), canvas, number);
  }
  std::vector<Pick> pick() override { return renderer_->pick(); }
  std::vector<float> readColor() const override { return renderer_->readColor(); }
  std::vector<float> readDepth() override { return renderer_->readDepth(); }
  void forget(const std::string& view_id) override { renderer_->forget(view_id); }

  DrawnBytes bytes() const override;

 private:
  void load(const GaussianEdit& page) override { painted_->load(page, painter().clock()); }
  void load(const MapState& map) override { painted_->load(map); }
  Painter& painter() const { return renderer_->painter(); }
  MapState reachable() const;
  // The picture with the maps as the painter holds them.
  static PaintedPicture painted(const Picture& picture);
  FrameReport describe(const Layer<Drawer*>& layer, const Painting& painting) const;

  std::shared_ptr<SoftwareRenderer> renderer_;
  Arrivals::Taker taker_;
  PaintedMapPtr painted_;
};

}  // namespace rosplat
