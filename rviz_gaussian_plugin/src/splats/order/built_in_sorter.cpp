#include "order/built_in_sorter.hpp"

#include <algorithm>
#include <chrono>
#include <new>

namespace rosplat {

namespace {
constexpr std::size_t kRecentEdits = 256;  // a sidecar further behind than this is not merged with
}

BuiltInSorter::BuiltInSorter(OrderPool& pool) : pool_(pool), thread_([this] { run(); }) {}

BuiltInSorter::~BuiltInSorter() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void BuiltInSorter::apply(EditQueue::Node edit) noexcept {
  {
    const std::lock_guard lock(mutex_);
    edits_.push(std::move(edit));
  }
  wake_.notify_one();
}

void BuiltInSorter::request(const std::string& view_id, std::uint64_t sequence,
                            const rosplat_sorter::View& view, OrderPtr base) {
  {
    const std::lock_guard lock(mutex_);
    requests_[view_id] = {sequence, view, std::move(base)};
  }
  wake_.notify_one();
}

OrderPtr BuiltInSorter::take(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  const auto found = orders_.find(view_id);
  if (found == orders_.end()) return nullptr;
  OrderPtr order = std::move(found->second);
  orders_.erase(found);
  return order;
}

OrderPtr BuiltInSorter::sortNow(const std::string& view_id, std::uint64_t sequence,
                                const rosplat_sorter::View& view) {
  std::unique_lock lock(mutex_);
  orders_.erase(view_id);
  requests_[view_id] = {sequence, view, nullptr};
  wake_.notify_one();
  finished_.wait(lock, [&] {
    const auto found = orders_.find(view_id);
    return found != orders_.end() && found->second->sequence == sequence;
  });
  OrderPtr order = std::move(orders_[view_id]);
  orders_.erase(view_id);
  return order;
}

void BuiltInSorter::forget(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  requests_.erase(view_id);
  orders_.erase(view_id);
}

std::size_t BuiltInSorter::bytes() const {
  const std::lock_guard lock(mutex_);
  return bytes_;
}

void BuiltInSorter::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [&] { return stop_ || !edits_.empty() || !requests_.empty(); });
    if (stop_) return;
    // A request sees every edit that came before it.
    while (!edits_.empty()) {
      const EditQueue::Waiting edit = edits_.pop();
      lock.unlock();
      apply(edit);
      lock.lock();
    }
    bytes_ = (positions_.capacity() + extents_.capacity()) * sizeof(float) +
             changed_at_.capacity() * sizeof(std::uint64_t);
    if (requests_.empty()) continue;
    const auto node = requests_.extract(requests_.begin());
    lock.unlock();
    OrderPtr order = sort(node.key(), node.mapped());
    lock.lock();
    orders_[node.key()] = std::move(order);
    finished_.notify_all();
  }
}

void BuiltInSorter::apply(const EditQueue::Waiting& item) {
  const GaussianEdit& edit = *item.edit;
  if (edit.clear) {
    positions_.clear();
    extents_.clear();
    out_of_memory_ = false;
  }
  if (edit.clear || edit.round != round_) {  // revisions so far say nothing any more
    changed_at_.assign(changed_at_.size(), 0);
    recent_.clear();
    begun_at_ = edit.revision;
  }
  map_id_ = item.state.id;
  round_ = edit.round;
  revision_ = edit.revision;
  if (out_of_memory_) return;
  try {
    hold(edit);
  } catch (const std::bad_alloc&) {
    positions_ = std::vector<float>();
    extents_ = std::vector<float>();
    changed_at_ = std::vector<std::uint64_t>();
    recent_.clear();
    out_of_memory_ = true;
  }
}

void BuiltInSorter::hold(const GaussianEdit& edit) {
  if (extents_.size() < edit.capacity) {
    positions_.resize(3 * std::size_t{edit.capacity}, 0.0f);
    extents_.resize(edit.capacity, -1.0f);
    changed_at_.resize(edit.capacity, 0);
  }
  std::size_t source = 0;
  for (const auto& [first, run_count] : edit.runs) {
    const std::size_t count =
        first < edit.capacity ? std::min(run_count, edit.capacity - first) : 0;
    if (edit.sh_degree >= 0) {
      std::copy_n(&edit.positions[3 * source], 3 * count,
                  positions_.data() + 3 * std::size_t{first});
      std::copy_n(&edit.extents[source], count, extents_.data() + first);
    } else {
      std::fill_n(extents_.data() + first, count, -1.0f);
    }
    std::fill_n(changed_at_.data() + first, count, edit.revision);
    source += run_count;
  }
  recent_.push_back({edit.revision, edit.runs});  // not the edit: its splats would stay in memory
  if (recent_.size() > kRecentEdits) recent_.pop_front();
}

OrderPtr BuiltInSorter::sort(const std::string& view_id, const Request& request) {
  const auto start = std::chrono::steady_clock::now();
  auto order = pool_.make();
  order->view_id = view_id;
  order->sequence = request.sequence;
  order->map_id = map_id_;
  order->revision = revision_;
  // Only an order of this map, not too far behind, can be brought up to date.
  const bool mergeable = request.base && request.base->map_id == map_id_ && !recent_.empty() &&
                         request.base->revision >= begun_at_ &&
                         request.base->revision + 1 >= recent_.front().revision;
  order->source = mergeable ? request.base->source + " + built-in" : "built-in";
  bool lacking = out_of_memory_;
  try {
    if (mergeable) {
      merge(request, order->slots);
    } else {
      depth_order_.sort(request.view, positions_.data(), extents_.data(), extents_.size(),
                        [&order](std::size_t total) {
                          order->slots.resize(total);
                          return order->slots.data();
                        });
    }
  } catch (const std::bad_alloc&) {
    lacking = true;
  }
  if (lacking) {
    order->slots.clear();
    order->source += " (out of memory)";
  }
  order->bound = extents_.size();
  order->sort_time =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return order;
}

void BuiltInSorter::merge(const Request& request, std::vector<std::uint32_t>& merged) {
  const std::uint64_t known = request.base->revision;
  std::vector<std::uint32_t> changed;
  for (const Change& change : recent_) {
    if (change.revision <= known) continue;
    for (const auto& [first, count] : change.runs) {
      for (std::uint32_t slot = first; slot < first + count && slot < extents_.size(); ++slot) {
        changed.push_back(slot);
      }
    }
  }
  std::sort(changed.begin(), changed.end());
  changed.erase(std::unique(changed.begin(), changed.end()), changed.end());
  const std::vector<std::uint32_t>& fresh = depth_order_.sort(
      request.view, positions_.data(), extents_.data(), changed.data(), changed.size());

  merged.clear();
  merged.reserve(request.base->slots.size() + fresh.size());
  auto next = fresh.begin();
  const auto depth = [&](std::uint32_t slot) {
    return rosplat_sorter::DepthOrder::depth(request.view, &positions_[3 * std::size_t{slot}]);
  };
  for (const std::uint32_t slot : request.base->slots) {
    if (slot >= changed_at_.size() || changed_at_[slot] > known) continue;
    const float here = depth(slot);
    while (next != fresh.end()) {
      const float there = depth(*next);
      if (there < here || (there == here && *next < slot)) break;
      merged.push_back(*next++);
    }
    merged.push_back(slot);
  }
  merged.insert(merged.end(), next, fresh.end());
}

}  // namespace rosplat
