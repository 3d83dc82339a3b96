#include "renderers.hpp"

#include "card_drawer.hpp"
#include "gl/driver.hpp"
#include "processor_drawer.hpp"

namespace rosplat {

namespace {

template <typename Renderer>
std::shared_ptr<Renderer> shared(std::weak_ptr<Renderer>& known, const ShaderSource& shaders) {
  std::shared_ptr<Renderer> renderer = known.lock();
  if (!renderer) known = renderer = std::make_shared<Renderer>(shaders);
  return renderer;
}

}  // namespace

std::shared_ptr<Renderers> Renderers::ofProcess(const ShaderSource& shaders) {
  static std::weak_ptr<Renderers> known;
  return shared(known, shaders);
}

std::shared_ptr<SplatRenderer> Renderers::onCard() { return shared(card_, shaders_); }

std::shared_ptr<SoftwareRenderer> Renderers::onProcessor() { return shared(processor_, shaders_); }

std::unique_ptr<Drawer> Renderers::makeDrawer(DrawnBy by, const Arrivals::Taker& taker) {
  if (by == DrawnBy::kCard) return std::make_unique<CardDrawer>(onCard(), taker);
  return std::make_unique<ProcessorDrawer>(onProcessor(), taker);
}

DrawnBy drawnBy(Rasterizer rasterizer) {
  // A card that can't draw is tried: then it is said why the processor draws.
  const bool by_processor =
      rasterizer == Rasterizer::kAuto ? !gl::accelerated() : rasterizer == Rasterizer::kProcessor;
  return by_processor ? DrawnBy::kProcessor : DrawnBy::kCard;
}

bool isEmulated(Rasterizer rasterizer) {
  return drawnBy(rasterizer) == DrawnBy::kCard && !gl::accelerated() && !gl::emulationIsWanted();
}

}  // namespace rosplat
