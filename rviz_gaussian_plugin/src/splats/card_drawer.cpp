#include "card_drawer.hpp"

#include <utility>

namespace rosplat {

namespace {

// The most that a frame uploads, so that a map that streams in doesn't stop the picture. [bytes]
constexpr std::size_t kUploadBytesPerFrame = 16u << 20;

}  // namespace

MapState CardDrawer::update(bool all) {
  UploadBudget budget;
  if (!all) budget.all = kUploadBytesPerFrame;
  const auto upload = [&](const EditQueue::Waiting& arrival) {
    apply(arrival);
    budget.used += uploadBytes(*arrival.edit);
  };
  while (taker_.applyNext(upload, budget)) {
  }
  card_->advanceLevels(renderer_->clock());
  return map_;
}

void CardDrawer::apply(const EditQueue::Waiting& arrival) {
  const auto& [edit, state, now, taken, more] = arrival;
  if (edit->clear) {
    // A map that comes in parts is built beside the drawn one, and shown once it is whole.
    const bool beside = more && map_.splats > 0;
    next_card_ = beside ? renderer_->makeMap() : nullptr;
  }
  MapState after = state;  // copied first: later memory may be lacking
  if (next_card_) {
    next_card_->apply(edit, renderer_->clock());
    next_map_ = std::move(after);
    if (!more) settle();
    return;
  }
  map_.torn = true;
  card_->apply(edit, renderer_->clock());
  map_ = std::move(after);
}

void CardDrawer::settle() {
  if (!next_card_) return;
  card_ = std::exchange(next_card_, nullptr);
  map_ = std::move(next_map_);
}

void CardDrawer::load(const GaussianEdit& page) {
  card_->apply(std::make_shared<const GaussianEdit>(page), renderer_->clock());
}

OrderPtr CardDrawer::unsorted() {
  const SlotPages& pages = card_->pages();
  const std::array<std::uint64_t, 3> of{map_.round, map_.capacity, pages.pages().size()};
  if (unsorted_ && unsorted_of_ == of) return unsorted_;
  auto order = std::make_shared<Order>();
  order->map_id = map_.id;
  order->source = "unsorted";
  order->slots = pages.slots(map_.capacity);
  order->bound = map_.capacity;
  unsorted_of_ = of;
  return unsorted_ = std::move(order);
}

bool CardDrawer::drawsWith(const Drawer& other) const {
  const auto* const on_card = dynamic_cast<const CardDrawer*>(&other);
  return on_card && on_card->renderer_ == renderer_;
}

CardPicture CardDrawer::onCard(const Picture& picture) {
  CardPicture on_card;
  for (const auto& [drawer, view_id, camera, settings, order, state] : picture.layers) {
    auto& of = static_cast<CardDrawer&>(*drawer);
    on_card.layers.push_back({of.card_, view_id, camera, settings, order, of.map_});
    if (picture.unsorted()) on_card.layers.back().order.order = of.unsorted();
  }
  return on_card;
}

std::vector<FrameReport> CardDrawer::draw(const Picture& picture, Canvas,
                                          const Surroundings& around) {
  const auto drawn = renderer_->draw(around);
  const OrderPtr order = picture.unsorted() ? unsorted() : picture.order();
  std::vector<FrameReport> reports(picture.layers.size());
  for (std::size_t i = 0; i < reports.size(); ++i) {
    FrameReport& report = reports[i];
    report.map = picture.layers[i].map->map();
    report.error = drawn[i].error;
    report.detail_error = drawn[i].detail_error;
    report.rasterizer = "tiles";
    report.emulated = renderer_->emulated();
    report.profile = renderer_->profile();
    if (!order) {
      report.splats = drawn[i].drawn;
      report.order_source = "gpu";
      report.order_fresh = true;
      const auto sort = report.profile.find("sort");
      if (sort != report.profile.end()) report.sort_time = sort->second;
    } else {
      report.splats = order->slots.size();
      report.order_source = order->source;
      report.order_fresh = picture.layers[i].order.fresh;
      report.order_age = picture.layers[i].order.age;
      report.sort_time = order->sort_time;
    }
  }
  return reports;
}

void CardDrawer::forget(const std::string& view_id) {
  renderer_->forget(view_id);
  card_->forget(view_id);
}

DrawnBytes CardDrawer::bytes() const {
  DrawnBytes bytes;
  bytes.map = card_->bytes();
  bytes.levels = card_->levelsBytes();
  bytes.gpu = card_->gpuBytes();
  bytes.shared_gpu = renderer_->gpuBytes();
  return bytes;
}

}  // namespace rosplat
