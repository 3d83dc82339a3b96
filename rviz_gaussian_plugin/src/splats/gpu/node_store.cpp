#include "gpu/node_store.hpp"

#include <algorithm>
#include <utility>

#include "gl/buffer.hpp"
#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kSlots = SlotPage::kSlots;

std::size_t pageBytes(int sh_degree) {
  std::size_t bytes = kSlotBytes;
  for (int band = 1; band <= sh_degree; ++band) bytes += bandBytes(band);
  return kSlots * bytes;
}

}  // namespace

void NodeStore::replace(const std::vector<Levels::Nodes>& groups, int sh_degree) {
  arenas_.addBands(sh_degree);
  next_pages_ = groups;
  next_groups_.assign(groups.size(), {});
  new_.clear();
  uploaded_ = 0;
  leaving_.clear();
  static const Levels::Nodes kNoNodes;
  static const OfGroup kNone;
  for (std::size_t group = 0; group < groups.size(); ++group) {
    const bool known = group < groups_.size();
    for (std::size_t level = 0; level < groups[group].size(); ++level) {
      replace(parentSize(groups[group], int(level)), (known ? pages_[group] : kNoNodes)[level],
              (known ? groups_[group] : kNone)[level], groups[group][level],
              next_groups_[group][level]);
    }
  }
  arenas_.makeRoom(places_);
}

// `before` and `pages` ascend by their cells.
// parent: width of the cells around the nodes' cells [m].
void NodeStore::replace(float parent, const Levels::Pages& before, const Level& held,
                        const Levels::Pages& pages, Level& next) {
  const auto free = [this] {
    if (free_.empty()) return places_++;
    const std::uint32_t place = free_.back();
    free_.pop_back();
    return place;
  };
  std::size_t old = 0;
  for (const auto& page : pages) {
    for (; old < before.size() && before[old] != page; ++old) {
      if (before[old]->cells.front() > page->cells.front()) break;
      leaving_.push_back(held.pages[old].place);
    }
    if (old < before.size() && before[old] == page) {
      next.pages.push_back(held.pages[old++]);
      continue;
    }
    next.pages.push_back(page->bounds);
    next.pages.back().place = free();
    new_.push_back({page, next.pages.back().place});
  }
  for (; old < before.size(); ++old) leaving_.push_back(held.pages[old].place);
  next.shelves = shelve(next.pages, [parent](const SlotPage&) { return parent; });
}

bool NodeStore::upload(std::size_t& bytes, ThreadTeam* team) {
  constexpr std::size_t kMostAtOnce = 64;
  const std::size_t of_page = pageBytes(arenas_.shDegree());
  while (uploaded_ < new_.size() && bytes > 0) {
    // Pages in neighbouring places are uploaded together.
    const New* const first = &new_[uploaded_];
    const SlotArenas::Place at = arenas_.placeOf(first->place);
    const std::size_t most = std::min({kMostAtOnce, new_.size() - uploaded_, bytes / of_page + 1});
    std::size_t count = 1;
    while (count < most && first[count].place == first->place + count &&
           arenas_.placeOf(first[count].place).arena == at.arena) {
      ++count;
    }
    write(first, count, team);
    uploaded_ += count;
    bytes -= std::min(bytes, count * of_page);
  }
  return uploaded_ == new_.size();
}

void NodeStore::write(const New* pages, std::size_t count, ThreadTeam* team) {
  const SlotArenas::Place at = arenas_.placeOf(pages->place);
  SlotArenas::Arena& arena = arenas_[at.arena];
  const auto put = [&](gl::Buffer& buffer, int band, std::size_t words) {
    staged_.resize(count * kSlots * words);
    inParts(team, count, [&](std::size_t i) {
      pages[i].page->slots.interleave(band, &staged_[i * kSlots * words]);
    });
    ring_->write(buffer, at.page * kSlots, count * kSlots, words, staged_.data());
  };
  put(arena.slots, 0, kSlotWords);
  for (int band = 1; band <= arenas_.shDegree(); ++band) {
    put(arena.bands[band], band, static_cast<std::size_t>(kBandWords[band]));
  }
}

void NodeStore::show() {
  pages_ = std::exchange(next_pages_, {});
  groups_ = std::exchange(next_groups_, {});
  new_.clear();
  uploaded_ = 0;
  free_.insert(free_.end(), leaving_.begin(), leaving_.end());
  leaving_.clear();
}

}  // namespace rosplat
