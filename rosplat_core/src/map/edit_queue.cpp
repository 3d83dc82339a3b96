#include "rosplat_core/map/edit_queue.hpp"

#include <algorithm>
#include <iterator>
#include <new>
#include <unordered_set>
#include <utility>
#include <vector>

namespace rosplat {

namespace {

std::size_t bytesOf(const EditQueue::Waiting& waiting) {
  const GaussianEdit& edit = *waiting.edit;
  return sizeof(waiting) + sizeof(edit) + waiting.state.id.capacity() + edit.bytes() +
         edit.runs.capacity() * sizeof(edit.runs[0]) + edit.extents.capacity() * sizeof(float) +
         edit.moves.capacity() * sizeof(GroupMove);
}

// Slots by their places in an edit's arrays, ascending: first, count.
using Places = std::vector<std::pair<std::size_t, std::size_t>>;

// An edit of some slots of another. rest: a part was taken before, and the clear and moves with it.
std::shared_ptr<const GaussianEdit> part(const GaussianEdit& edit, bool rest, const Places& kept) {
  auto taken = std::make_shared<GaussianEdit>();
  taken->clear = edit.clear && !rest;
  taken->round = edit.round;
  taken->revision = edit.revision;
  taken->capacity = edit.capacity;
  taken->sh_degree = edit.sh_degree;
  taken->group = edit.group;
  taken->origin = edit.origin;
  if (!rest) taken->moves = edit.moves;
  std::size_t begin = 0;  // of a run
  auto range = kept.begin();
  for (const auto& [first, length] : edit.runs) {
    const std::size_t end = begin + length;
    for (; range != kept.end() && range->first < end; ++range) {
      const std::size_t from = std::max(begin, range->first), to = range->first + range->second;
      taken->runs.emplace_back(first + std::uint32_t(from - begin),
                               std::uint32_t(std::min(end, to) - from));
      if (to > end) break;  // it goes on in the next run
    }
    begin = end;
  }
  taken->runs.shrink_to_fit();
  const auto copy = [&](std::size_t width, const auto& values, auto& to) {
    if (values.empty()) return;
    to.reserve(width * countSlots(taken->runs));
    for (const auto& [first, count] : kept) {
      const auto at = values.begin() + std::ptrdiff_t(width * first);
      to.insert(to.end(), at, at + std::ptrdiff_t(width * count));
    }
  };
  copy(1, edit.extents, taken->extents);
  forEachArray(copy, edit, *taken);
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

EditQueue::Node EditQueue::pop(std::size_t most_bytes) {
  Waiting& oldest = waiting_.front();
  const std::size_t bytes = uploadBytes(*oldest.edit), slots = countSlots(oldest.edit->runs);
  if (oldest.taken == 0 && bytes <= most_bytes) return popNode();
  const std::size_t count =
      std::min(std::max<std::size_t>(most_bytes / (bytes / slots), 1), slots - oldest.taken);
  Node taken =
      node(part(*oldest.edit, oldest.taken > 0, {{oldest.taken, count}}), oldest.state, oldest.now);
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
    const std::size_t taken = waiting->taken, slots = countSlots(edit.runs);
    Places kept;
    std::size_t i = slots, count = 0;
    // Backwards, because the last entry counts if a slot is listed twice.
    for (auto run = edit.runs.rbegin(); run != edit.runs.rend(); ++run) {
      for (std::uint32_t k = run->second; k > 0; --k) {
        if (--i < taken || later.set(run->first + k - 1, true)) continue;
        if (kept.empty() || kept.back().first != i + 1) kept.emplace_back(i + 1, 0);
        --kept.back().first;
        ++kept.back().second;
        ++count;
      }
    }
    std::reverse(kept.begin(), kept.end());
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
    if (count < slots - taken) {
      auto rest = part(edit, taken > 0, kept);
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
