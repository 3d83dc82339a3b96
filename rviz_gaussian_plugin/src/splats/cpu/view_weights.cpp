#include "cpu/view_weights.hpp"

#include <algorithm>
#include <cmath>

namespace rosplat {

double ViewWeights::finish(Page& page, float least) const {
  double sum = 0;  // of those that would have been left out, but for their turn
  std::size_t samples = 0, left_out = 0;
  for (std::size_t slot = 0; slot < page.next.size(); ++slot) {
    left_out += std::signbit(page.next[slot]);
    if (page.next[slot] == kUnknown || page.last[slot] >= least || !hasItsTurn(slot)) continue;
    ++samples;
    sum += page.next[slot];
  }
  const double mean = samples > 0 ? sum / double(samples) : 0;
  for (float& weight : page.next) {
    if (std::signbit(weight)) weight = std::max(-weight, static_cast<float>(mean));
  }
  page.last = page.next;
  page.picture = picture_;
  return mean * double(left_out);
}

ViewWeights::Page& ViewWeights::page(const SlotPage& of) {
  if (of.place >= pages_.size()) pages_.resize(of.place + 1);
  std::unique_ptr<Page>& page = pages_[of.place];
  if (!page) page = std::make_unique<Page>();
  if (page->picture == 0 || page->picture != whole_) page->last.fill(kUnknown);
  return *page;
}

void ViewWeights::forget(const SlotPages& index, const GaussianEdit& edit) {
  if (edit.clear || !edit.moves.empty()) pages_.clear();
  for (const auto& [first, count] : edit.runs) {
    for (std::uint32_t done = 0; done < count;) {
      const std::uint32_t slot = first + done, in_page = slot % SlotPage::kSlots;
      const std::uint32_t here = std::min(count - done, SlotPage::kSlots - in_page);
      const SlotPage* const page = index.find(slot);
      if (page && page->place < pages_.size() && pages_[page->place]) {
        std::fill_n(pages_[page->place]->last.begin() + in_page, here, kUnknown);
      }
      done += here;
    }
  }
}

std::size_t ViewWeights::bytes() const {
  std::size_t pages = 0;
  for (const auto& page : pages_) pages += page != nullptr;
  return pages * sizeof(Page) + pages_.capacity() * sizeof(pages_[0]);
}

}  // namespace rosplat
