#include "rosplat_core/order/built_in_sorter.hpp"

#include <algorithm>
#include <chrono>
#include <new>

namespace rosplat {

namespace {

// Resizes with room for a quarter more: doubling would take too much memory.
template <typename T>
void grow(std::vector<T>& values, std::size_t size, T value) {
  if (size > values.capacity()) values.reserve(size + size / 4);
  values.resize(size, value);
}

}  // namespace

BuiltInSorter::BuiltInSorter(OrderPool& pool, Feed feed)
    : pool_(pool), feed_(std::move(feed)), rests_(bool(feed_)), thread_([this] { run(); }) {}

BuiltInSorter::~BuiltInSorter() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void BuiltInSorter::begin() {
  if (!std::exchange(rests_, false)) return;
  try {
    feed_();
  } catch (...) {
    rests_ = true;  // the next feed begins with a clear
    throw;
  }
}

void BuiltInSorter::rest() {
  auto nothing = std::make_shared<GaussianEdit>();
  nothing->clear = true;
  apply(EditQueue::node(std::move(nothing), {}));
  rests_ = bool(feed_);
}

void BuiltInSorter::apply(EditQueue::Node edit) noexcept {
  if (rests_) return;
  {
    const std::lock_guard lock(mutex_);
    edits_.push(std::move(edit));
  }
  wake_.notify_one();
}

// Allocates for the worker, which can't report std::bad_alloc, all but the memory to sort in.
std::unique_lock<std::mutex> BuiltInSorter::ask(const std::string& view_id, std::uint64_t sequence,
                                                const SplatCamera& camera, OrderPtr base) {
  begin();
  auto order = pool_.make();
  order->view_id = view_id;
  order->sequence = sequence;
  order->source = "built-in (out of memory)";
  order->slots.clear();
  std::unique_lock lock(mutex_);
  orders_.try_emplace(view_id);
  requests_[view_id] = {camera, std::move(base), std::move(order)};
  wake_.notify_one();
  return lock;
}

void BuiltInSorter::request(const std::string& view_id, std::uint64_t sequence,
                            const SplatCamera& camera, OrderPtr base) {
  ask(view_id, sequence, camera, std::move(base));
}

OrderPtr BuiltInSorter::take(const std::string& view_id) {
  const std::lock_guard lock(mutex_);
  const auto found = orders_.find(view_id);
  return found == orders_.end() ? nullptr : std::exchange(found->second, nullptr);
}

OrderPtr BuiltInSorter::sortNow(const std::string& view_id, std::uint64_t sequence,
                                const SplatCamera& camera) {
  std::unique_lock lock = ask(view_id, sequence, camera, nullptr);
  OrderPtr& order = orders_[view_id];
  order = nullptr;
  // A sort that is in progress lacks the newest edits, and ends with another order.
  const Order* const asked = requests_[view_id].order.get();
  finished_.wait(lock, [&] { return order.get() == asked; });
  return std::exchange(order, nullptr);
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
    // A request must see every edit that came before it.
    while (!edits_.empty()) {
      EditQueue::Waiting edit = edits_.pop();
      lock.unlock();
      apply(std::move(edit));
      lock.lock();
    }
    bytes_ = rows_.bytes() + changed_at_.capacity() * sizeof(std::uint64_t);
    if (requests_.empty()) continue;
    const auto node = requests_.extract(requests_.begin());
    lock.unlock();
    OrderPtr order = sort(node.mapped());
    lock.lock();
    const auto asked = orders_.find(node.key());
    if (asked != orders_.end()) asked->second = std::move(order);  // else it was forgotten
    finished_.notify_all();
  }
}

void BuiltInSorter::apply(EditQueue::Waiting item) noexcept {
  const GaussianEdit& edit = *item.edit;
  const auto forget = [this] {
    rows_ = SplatRows();
    changed_at_ = std::vector<std::uint64_t>();
    page_changed_ = std::vector<std::uint64_t>();
    capacity_ = 0;
  };
  if (edit.clear) {
    forget();
    depth_order_.release();
    out_of_memory_ = false;
  }
  if (edit.clear || edit.round != round_) {  // former revisions are void
    std::fill(changed_at_.begin(), changed_at_.end(), 0);
    std::fill(page_changed_.begin(), page_changed_.end(), 0);
    begun_at_ = edit.revision;
  }
  if (!edit.moves.empty()) begun_at_ = edit.revision;
  map_id_ = std::move(item.state.id);
  round_ = edit.round;
  revision_ = edit.revision;
  if (out_of_memory_) return;
  try {
    hold(edit);
  } catch (const std::bad_alloc&) {
    forget();
    out_of_memory_ = true;
  }
}

void BuiltInSorter::hold(const GaussianEdit& edit) {
  const SplatRows::Runs changed = rows_.apply(edit);
  capacity_ = edit.capacity;
  grow(changed_at_, rows_.size(), std::uint64_t{0});
  grow(page_changed_, rows_.size() / SlotPage::kSlots, std::uint64_t{0});
  for (const auto& [first, count] : changed) {
    std::fill_n(&changed_at_[first], count, edit.revision);
    const std::size_t page = first / SlotPage::kSlots;
    const std::size_t last = (first + count - 1) / SlotPage::kSlots;
    std::fill_n(&page_changed_[page], last - page + 1, edit.revision);
  }
}

OrderPtr BuiltInSorter::sort(const Request& request) noexcept {
  const auto start = std::chrono::steady_clock::now();
  const std::shared_ptr<Order>& order = request.order;
  order->revision = revision_;
  // Only an order of this map, not older than begun_at_, can be brought up to date.
  const bool mergeable =
      request.base && request.base->map_id == map_id_ && request.base->revision >= begun_at_;
  try {
    order->map_id = map_id_;
    if (mergeable) {
      merge(request, order->slots);
    } else {
      sortAll(request, order->slots);
    }
    if (!out_of_memory_) {
      order->source = mergeable ? request.base->source + " + built-in" : "built-in";
    }
  } catch (const std::bad_alloc&) {
    order->slots.clear();
  }
  order->bound = capacity_;
  order->sort_time =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return order;
}

std::vector<SortView> BuiltInSorter::viewsOf(const SplatCamera& camera) const {
  std::vector<SortView> views;
  for (const Group& group : rows_.pages().groups()) {
    views.push_back(sortView(inFrameOf(group.place, camera), group.originOrZero()));
  }
  return views;
}

void BuiltInSorter::sortAll(const Request& request, std::vector<std::uint32_t>& slots) {
  const std::vector<SortView> views = viewsOf(request.camera);
  std::vector<SortPage> pages;
  pages.reserve(rows_.pages().pages().size());
  for (const SlotPage& page : rows_.pages().pages()) {
    pages.push_back({page.first_slot, page.place, page.group});
  }
  depth_order_.sort(views.data(), rows_.positions(), rows_.extents(), pages.data(), pages.size(),
                    [&slots](std::size_t total) {
                      slots.resize(total);
                      return slots.data();
                    });
}

void BuiltInSorter::merge(const Request& request, std::vector<std::uint32_t>& merged) {
  const std::uint64_t known = request.base->revision;
  const std::vector<SortView> views = viewsOf(request.camera);
  std::vector<const SlotPage*> page_of(capacity_ / SlotPage::kSlots + 1, nullptr);
  std::vector<std::uint32_t> changed, view_of;
  std::vector<float> positions, extents;  // of these
  for (const SlotPage& page : rows_.pages().pages()) {
    const std::size_t first = SplatRows::rowOf(page);
    page_of[page.first_slot / SlotPage::kSlots] = &page;
    if (page_changed_[page.place] <= known) continue;
    for (std::size_t row = first; row < first + SlotPage::kSlots; ++row) {
      if (changed_at_[row] <= known) continue;
      changed.push_back(page.first_slot + static_cast<std::uint32_t>(row - first));
      view_of.push_back(page.group);
      const float* const position = rows_.positions() + 3 * row;
      positions.insert(positions.end(), position, position + 3);
      extents.push_back(rows_.extents()[row]);
    }
  }
  const std::vector<std::uint32_t>& fresh =
      depth_order_.sort(views.data(), positions.data(), extents.data(), changed.data(),
                        view_of.data(), changed.size());

  merged.clear();
  merged.reserve(request.base->slots.size() + fresh.size());
  auto next = fresh.begin();
  const auto pageOf = [&](std::uint32_t slot) {
    const std::size_t page = slot / SlotPage::kSlots;
    return page < page_of.size() ? page_of[page] : nullptr;
  };
  const auto depth = [&](std::uint32_t slot) {
    const SlotPage& page = *pageOf(slot);
    const std::size_t row = SplatRows::rowOf(page) + slot % SlotPage::kSlots;
    return DepthOrder::depth(views[page.group], rows_.positions() + 3 * row);
  };
  for (const std::uint32_t slot : request.base->slots) {
    const SlotPage* const page = pageOf(slot);
    if (!page || changed_at_[SplatRows::rowOf(*page) + slot % SlotPage::kSlots] > known) continue;
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
