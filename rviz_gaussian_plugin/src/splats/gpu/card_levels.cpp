#include "gpu/card_levels.hpp"

#include <algorithm>
#include <iterator>
#include <limits>
#include <utility>

namespace rosplat {

namespace {

// Limits of a frame: pages to read back, pages to read at once, and bytes to upload.
constexpr std::size_t kPagesPerFrame = 64, kPagesAtOnce = 256, kBytesPerFrame = 32u << 20;
constexpr std::size_t kEverything = std::numeric_limits<std::size_t>::max();

}  // namespace

void CardLevels::apply(const SlotStore& store, const std::shared_ptr<const GaussianEdit>& edit,
                       double now) {
  const std::uint64_t number = builder_.apply(edit, now);
  if (edit->clear) {
    cleared_ = number;
    copied_ = kNoSlot;
    builder_.expectMore(false);
    written_.clear();
    update_.reset();
    nodes_ = NodeStore(ring_);
    samples_.clear();
  }
  nodes_.addBands(store.shDegree());
  markWritten(*edit, number);
}

void CardLevels::markWritten(const GaussianEdit& edit, std::uint64_t number) {
  if (edit.sh_degree < 0) return;
  std::size_t source = 0;
  std::uint32_t first_slot = kNoSlot;
  Written* page = nullptr;
  forEachSlot(edit.runs, [&](std::uint32_t slot) {
    const std::uint32_t in_page = slot % SlotPage::kSlots;
    if (slot - in_page != first_slot) {
      first_slot = slot - in_page;
      auto& held = written_[first_slot];
      if (!held) held = std::make_unique<Written>();
      page = held.get();
    }
    page->numbers[in_page] = number;
    page->levels[in_page] = levelOfNew(edit, source++);
  });
}

// Gives the builder pages of the map that it lacks.
void CardLevels::copy(const SlotStore& store, double now, std::size_t most_pages) {
  if (copied_ == kNoSlot) return;
  const auto& pages = store.pages().pages();
  if (copied_ == 0) {
    builder_.expectMore(true);
    builder_.apply(std::make_shared<const GaussianEdit>(store.pages().moves()), now);
  }
  const auto from = std::lower_bound(
      pages.begin(), pages.end(), copied_,
      [](const SlotPage& of, std::uint32_t first_slot) { return of.first_slot < first_slot; });
  auto i = std::size_t(from - pages.begin());
  while (i < pages.size() && most_pages > 0) {
    std::size_t count = 1;
    if (store.holds(pages[i])) {
      PackedRun run = reader_.read(store, i, std::min(most_pages, kPagesAtOnce), builder_.spare());
      count = run.slots.size() / (kSlotWords * SlotPage::kSlots);
      builder_.apply(std::move(run), now);
    }
    i += count;
    most_pages -= count;
    copied_ = pages[i - 1].first_slot + 1;
  }
  if (i < pages.size()) return;
  copied_ = kNoSlot;
  builder_.expectMore(false);
  reader_ = {};
}

void CardLevels::advance(SlotStore& store, double now, bool all) {
  copy(store, now, all ? kEverything : kPagesPerFrame);
  std::size_t budget = all ? kEverything : kBytesPerFrame;
  do {
    if (!update_) {
      update_ = builder_.update(all);
      if (update_ && update_->edits < cleared_) update_.reset();
      if (!update_) return;
      nodes_.replace(update_->groups, store.shDegree());
    }
    if (!nodes_.upload(budget, all ? team_.get() : nullptr)) return;
    finish(store);
  } while (all);
}

// From here on the new nodes are drawn in place of the slots that they hold.
void CardLevels::finish(SlotStore& store) {
  // Slots that were written since the update are in no node.
  for (auto& [first_slot, levels] : update_->entries) {
    const auto page = written_.find(first_slot);
    if (page == written_.end()) continue;
    auto& [numbers, of_new] = *page->second;
    for (std::size_t i = 0; i < levels.size(); ++i) {
      if (numbers[i] > update_->edits) levels[i] = of_new[i];
    }
  }
  for (auto page = written_.begin(); page != written_.end();) {
    const auto& numbers = page->second->numbers;
    const bool done = *std::max_element(numbers.begin(), numbers.end()) <= update_->edits;
    page = done ? written_.erase(page) : std::next(page);
  }
  for (const auto& [first_slot, levels] : update_->entries) store.setLevels(first_slot, levels);
  nodes_.show();
  samples_ = std::move(update_->samples);
  update_.reset();
}

}  // namespace rosplat
