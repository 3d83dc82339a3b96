#include "map/level_builder.hpp"

#include <cmath>
#include <new>
#include <set>
#include <utility>

#include "map/give_way.hpp"

namespace rosplat {

namespace {

EntryLevels entriesOf(const HostSlots::Page& page) {
  EntryLevels levels;
  for (std::size_t i = 0; i < levels.size(); ++i) {
    const float parent = page.parents ? (*page.parents)[i] : kBoundless;
    levels[i] = parent == 0 ? std::uint8_t{0}
                : parent < kBoundless
                    ? static_cast<std::uint8_t>(std::ilogb(parent) - kFinestOctave)
                    : kNoLevel;
  }
  return levels;
}

}  // namespace

LevelBuilder::LevelBuilder()
    : levels_(rosplat_sorter::ThreadTeam::ofViewers()), thread_([this] { run(); }) {}

LevelBuilder::~LevelBuilder() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

std::uint64_t LevelBuilder::apply(std::shared_ptr<const GaussianEdit> edit, double now) {
  std::uint64_t number;
  {
    const std::lock_guard lock(mutex_);
    number = ++applied_;
    if (edit->clear) waiting_.clear();
    if (error_.empty()) waiting_.push_back({std::move(edit), now, number});
  }
  wake_.notify_one();
  return number;
}

std::unique_ptr<LevelsUpdate> LevelBuilder::take(bool wait) {
  std::unique_lock lock(mutex_);
  if (wait) rests_.wait(lock, [this] { return waiting_.empty() && !busy_; });
  return std::move(update_);
}

std::string LevelBuilder::error() const {
  const std::lock_guard lock(mutex_);
  return error_;
}

void LevelBuilder::run() {
  giveWay();
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return stop_ || !waiting_.empty(); });
    if (stop_) return;
    busy_ = true;
    lock.unlock();
    std::string error;
    try {
      build();
    } catch (const std::bad_alloc&) {
      error = "there is no memory for levels of detail";
    }
    lock.lock();
    if (!error.empty()) {
      error_ = std::move(error);
      waiting_.clear();
    }
    busy_ = false;
    rests_.notify_all();
    lock.unlock();
    bytes_ = slots_.bytes() + levels_.bytes();
    lock.lock();
  }
}

// Takes what waits into the slots, and that into the nodes, until more waits.
void LevelBuilder::build() {
  const auto next = [this](Waiting& edit) {
    const std::lock_guard lock(mutex_);
    if (waiting_.empty() || stop_) return false;
    edit = std::move(waiting_.front());
    waiting_.pop_front();
    if (edit.edit->clear) update_.reset();
    return true;
  };
  for (Waiting edit; next(edit);) {
    if (edit.edit->clear) levels_.clear();
    taken_ = edit.number;
    slots_.apply(*edit.edit, edit.now);
    levels_.mark(slots_, edit.edit->runs);
  }
  levels_.advance(
      slots_,
      [this] {
        const std::lock_guard lock(mutex_);
        return stop_ || !waiting_.empty();
      },
      [this](const std::vector<std::uint32_t>& changed) { handOver(changed); });
}

void LevelBuilder::handOver(const std::vector<std::uint32_t>& changed) {
  std::set<std::uint32_t> pages(changed.begin(), changed.end());
  {
    const std::lock_guard lock(mutex_);
    // What nobody took may have been written since.
    for (std::size_t i = 0; update_ && i < update_->entries.size(); ++i) {
      pages.insert(update_->entries[i].first);
    }
  }
  auto update = std::make_unique<LevelsUpdate>();
  update->edits = taken_;
  update->groups = levels_.groups();
  for (const std::uint32_t first_slot : pages) {
    update->entries.emplace_back(first_slot,
                                 entriesOf(slots_.at(*slots_.index().find(first_slot))));
  }
  const std::lock_guard lock(mutex_);
  update_ = std::move(update);
}

}  // namespace rosplat
