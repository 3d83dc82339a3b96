#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "drawer.hpp"
#include "rosplat_core/map/arrivals.hpp"
#include "splat_renderer.hpp"

namespace rosplat {

// A map on the graphics card.
class CardDrawer : public Drawer {
 public:
  CardDrawer(std::shared_ptr<SplatRenderer> renderer, Arrivals::Taker taker)
      : renderer_(std::move(renderer)), taker_(std::move(taker)) {}

  DrawnBy by() const override { return DrawnBy::kCard; }

  MapState update(bool all) override;
  void settle() override;
  MapState map() const override { return map_; }
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const override {
    card_->forEachPage(take);
  }
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const override {
    return renderer_->readSlots(*card_, slots);
  }

  bool drawsWith(const Drawer& other) const override;
  void begin(const Picture& picture, Canvas canvas) override {
    renderer_->begin(onCard(picture), canvas);
  }
  std::vector<FrameReport> draw(const Picture& picture, Canvas canvas,
                                const Surroundings& around) override;
  void hideFarther(const std::string& view_id) const override { renderer_->hideFarther(view_id); }
  void drawBefore(const std::string& view_id) const override { renderer_->drawBefore(view_id); }
  void drawSurface(const Picture& picture, Canvas canvas, double far_clip) override {
    renderer_->drawSurface(onCard(picture), canvas, far_clip);
  }
  void drawPick(const Picture& picture, Canvas canvas, std::uint32_t number) override {
    renderer_->drawPick(onCard(picture), canvas, number);
  }
  std::vector<Pick> pick() override { return renderer_->readPick(); }
  std::vector<float> readColor() const override { return renderer_->readColor(); }
  std::vector<float> readDepth() override { return renderer_->readDepth(); }
  void forget(const std::string& view_id) override;

  std::string warning() const override { return renderer_->warning(); }
  DrawnBytes bytes() const override;

 private:
  void load(const GaussianEdit& page) override;
  void load(const MapState& map) override { map_ = map; }
  void apply(const EditQueue::Waiting& arrival);
  OrderPtr unsorted();
  // The picture with the maps as the card holds them.
  static CardPicture onCard(const Picture& picture);

  std::shared_ptr<SplatRenderer> renderer_;
  Arrivals::Taker taker_;
  std::shared_ptr<CardMap> card_ = renderer_->makeMap();
  MapState map_;
  std::shared_ptr<CardMap> next_card_;  // replaces card_ once it is whole
  MapState next_map_;
  OrderPtr unsorted_;
  std::array<std::uint64_t, 3> unsorted_of_{};  // round, capacity and number of pages
};

}  // namespace rosplat
