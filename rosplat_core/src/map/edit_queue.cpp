#include "rosplat_core/map/edit_queue.hpp"

#include <algorithm>
#include <iterator>
#include <new>
#include <unordered_set>
#include <utility>
#include <vector>

namespace rosplat {

namespace {

template <typename T>
std::size_t bytesOf(const std::vector<T>& values) {
  return values.capacity() * sizeof(T);
}

std::size_t bytesOf(const EditQueue::Waiting& waiting) {
  const GaussianEdit& edit = *waiting.edit;
  std::size_t bytes = sizeof(waiting) + sizeof(edit) + waiting.state.id.capacity();
  for (const auto& band : edit.bands) bytes += bytesOf(band);
  for (const auto& channel : edit.channels) bytes += bytesOf(channel);
  return bytes + bytesOf(edit.runs) + bytesOf(edit.slots) + bytesOf(edit.extents) +
         bytesOf(edit.moves);
}

// The kept ones of elements of `width` values each; count: how many are kept.
template <typename T>
std::vector<T> part(const std::vector<T>& values, std::size_t width, const std::vector<bool>& kept,
                    std::size_t count) {
  std::vector<T> taken;
  if (values.empty()) return taken;
  taken.reserve(width * count);
  for (std::size_t i = 0; i < kept.size(); ++i) {
    if (kept[i]) {
      const auto begin = values.begin() + static_cast<std::ptrdiff_t>(width * i);
      taken.insert(taken.end(), begin, begin + static_cast<std::ptrdiff_t>(width));
    }
  }
  return taken;
}

// An edit without its slots. rest: a part was taken before, and the clear and moves with it.
std::shared_ptr<GaussianEdit> frame(const GaussianEdit& edit, bool rest) {
  auto taken = std::make_shared<GaussianEdit>();
  taken->clear = edit.clear && !rest;
  taken->round = edit.round;
  taken->revision = edit.revision;
  taken->capacity = edit.capacity;
  taken->sh_degree = edit.sh_degree;
  taken->group = edit.group;
  taken->origin = edit.origin;
  if (!rest) taken->moves = edit.moves;
  return taken;
}

// An edit without the slots that aren't kept; count: how many are.
std::shared_ptr<const GaussianEdit> part(const GaussianEdit& edit, bool rest,
                                         const std::vector<bool>& kept, std::size_t count) {
  const auto taken = frame(edit, rest);
  std::size_t i = 0;
  for (const auto& [first, length] : edit.runs) {
    bool goes_on = false;
    for (std::uint32_t k = 0; k < length; ++k, ++i) {
      if (kept[i] && goes_on) {
        ++taken->runs.back().second;
      } else if (kept[i]) {
        taken->runs.emplace_back(first + k, 1);
      }
      goes_on = kept[i];
    }
  }
  taken->runs.shrink_to_fit();
  taken->slots = part(edit.slots, kSlotWords, kept, count);
  taken->extents = part(edit.extents, 1, kept, count);
  for (std::size_t band = 1; band < edit.bands.size(); ++band) {
    taken->bands[band] = part(edit.bands[band], kBandWords[band], kept, count);
  }
  for (std::size_t channel = 0; channel < edit.channels.size(); ++channel) {
    taken->channels[channel] = part(edit.channels[channel], 1, kept, count);
  }
  return taken;
}

// An edit of `count` slots of another, starting at slot number `from` of its runs.
std::shared_ptr<const GaussianEdit> part(const GaussianEdit& edit, std::size_t from,
                                         std::size_t count) {
  const auto taken = frame(edit, from > 0);
  std::size_t begin = 0;  // of a run
  for (const auto& [first, length] : edit.runs) {
    const std::size_t in_run = std::max(begin, from);
    const std::size_t end = std::min(begin + length, from + count);
    if (in_run < end) {
      taken->runs.emplace_back(first + std::uint32_t(in_run - begin), std::uint32_t(end - in_run));
    }
    begin += length;
  }
  const auto of = [&](const auto& values, std::size_t width, auto& to) {
    if (values.empty()) return;
    const auto at = values.begin() + std::ptrdiff_t(width * from);
    to.assign(at, at + std::ptrdiff_t(width * count));
  };
  of(edit.slots, kSlotWords, taken->slots);
  of(edit.extents, 1, taken->extents);
  for (std::size_t band = 1; band < edit.bands.size(); ++band) {
    of(edit.bands[band], std::size_t(kBandWords[band]), taken->bands[band]);
  }
  for (std::size_t channel = 0; channel < edit.channels.size(); ++channel) {
    of(edit.channels[channel], 1, taken->channels[channel]);
  }
  return taken;
}

// An edit with further moves, except of groups that it moves itself.
std::shared_ptr<const GaussianEdit> withMoves(const GaussianEdit& edit,
                                              const std::vector<GroupMove>& moves) {
  auto taken = std::make_shared<GaussianEdit>(edit);
  std::unordered_set<std::uint32_t> moved;
  for (const GroupMove& move : edit.moves) moved.insert(move.group);
  std::copy_if(moves.begin(), moves.end(), std::back_inserter(taken->moves),
               [&](const GroupMove& move) { return moved.count(move.group) == 0; });
  return taken;
}

}  // namespace

std::size_t uploadBytes(const GaussianEdit& edit) {
  std::size_t words = kSlotWords * countSlots(edit.runs);
  for (const auto& band : edit.bands) words += band.size();
  for (const auto& channel : edit.channels) words += channel.size();
  return words * sizeof(std::uint32_t);
}

void EditQueue::push(Node node) noexcept {
  if (node.front().edit->clear) clear();
  bytes_ += bytesOf(node.front());
  waiting_.splice(waiting_.end(), node);
  if (bytes_ <= settled_ + std::max(worthwhile_, settled_ / 2)) return;
  try {
    coalesce();
  } catch (const std::bad_alloc&) {  // the queue is valid after each step
  }
  settled_ = bytes_;
}

EditQueue::Waiting EditQueue::pop() { return std::move(popNode().front()); }

EditQueue::Node EditQueue::popNode() noexcept {
  Node oldest;
  oldest.splice(oldest.end(), waiting_, waiting_.begin());
  bytes_ -= bytesOf(oldest.front());
  settled_ = std::min(settled_, bytes_);
  return oldest;
}

EditQueue::Node EditQueue::take(std::size_t most_bytes) {
  Waiting& oldest = waiting_.front();
  const std::size_t bytes = uploadBytes(*oldest.edit), slots = countSlots(oldest.edit->runs);
  if (oldest.taken == 0 && bytes <= most_bytes) return popNode();
  const std::size_t count =
      std::min(std::max<std::size_t>(most_bytes / (bytes / slots), 1), slots - oldest.taken);
  Node taken = node(part(*oldest.edit, oldest.taken, count), oldest.state, oldest.now);
  oldest.taken += count;
  if (oldest.taken == slots) {
    popNode();
  } else {
    taken.front().more = taken.front().state.pulled = true;
  }
  return taken;
}

void EditQueue::putBack(Node node) noexcept {
  const bool cleared =
      !waiting_.empty() && waiting_.front().edit->clear && waiting_.front().taken == 0;
  if (cleared) return;
  bytes_ += bytesOf(node.front());
  waiting_.splice(waiting_.begin(), node);
}

void EditQueue::clear() {
  waiting_.clear();
  bytes_ = settled_ = 0;
}

void EditQueue::coalesce() {
  SlotSet later;
  // The next edit that moves groups, and the groups that are written to before it.
  auto next_move = waiting_.end();
  std::unordered_set<std::uint32_t> written;
  for (auto next = waiting_.end(); next != waiting_.begin();) {
    const auto waiting = std::prev(next);
    const std::shared_ptr<const GaussianEdit> held = waiting->edit;  // while a part replaces it
    const GaussianEdit& edit = *held;
    later.makeRoom(edit.runs);
    const std::size_t taken = waiting->taken;
    std::vector<bool> kept(countSlots(edit.runs));
    std::size_t i = kept.size(), count = 0;
    // Backwards, because the last entry counts if a slot is listed twice.
    for (auto run = edit.runs.rbegin(); run != edit.runs.rend(); ++run) {
      for (std::uint32_t k = run->second; k > 0; --k) {
        --i;
        kept[i] = i >= taken && !later.set(run->first + k - 1, true);
        count += kept[i];
      }
    }
    bool moves = !edit.moves.empty() && taken == 0;
    if (moves && next_move != waiting_.end() &&
        std::none_of(edit.moves.begin(), edit.moves.end(),
                     [&](const GroupMove& move) { return written.count(move.group) > 0; })) {
      auto both = withMoves(*next_move->edit, edit.moves);
      bytes_ -= bytesOf(*next_move);
      next_move->edit = std::move(both);
      bytes_ += bytesOf(*next_move);
      moves = false;
    }
    const bool last = next == waiting_.end();
    const bool clear = edit.clear && taken == 0;
    if (count == 0 && !moves && !clear && !last) {
      bytes_ -= bytesOf(*waiting);
      waiting_.erase(waiting);
      continue;
    }
    if (count < kept.size() - taken) {
      auto rest = part(edit, taken > 0, kept, count);
      bytes_ -= bytesOf(*waiting);
      waiting->edit = std::move(rest);
      waiting->taken = 0;
      bytes_ += bytesOf(*waiting);
    }
    if (moves) {
      next_move = waiting;
      written.clear();
    } else if (edit.sh_degree >= 0 && count > 0) {
      written.insert(edit.group);
    }
    next = waiting;
  }
}

}  // namespace rosplat
