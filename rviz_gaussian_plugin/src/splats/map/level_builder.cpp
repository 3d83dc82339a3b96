#include "map/level_builder.hpp"

#include <algorithm>
#include <cmath>
#include <new>
#include <set>
#include <utility>

#include "map/give_way.hpp"
#include "map/in_parts.hpp"

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
    : team_(rosplat_sorter::ThreadTeam::ofViewers()), levels_(team_), thread_([this] { run(); }) {}

LevelBuilder::~LevelBuilder() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

std::uint64_t LevelBuilder::apply(std::shared_ptr<const GaussianEdit> edit, double now) {
  return push({std::move(edit), {}, now, 0});
}

std::uint64_t LevelBuilder::apply(PackedRun run, double now) {
  return push({nullptr, std::move(run), now, 0});
}

PackedRun LevelBuilder::spare() {
  const std::lock_guard lock(mutex_);
  if (spare_.empty()) return {};
  PackedRun run = std::move(spare_.back());
  spare_.pop_back();
  return run;
}

void LevelBuilder::expectMore(bool more) {
  {
    const std::lock_guard lock(mutex_);
    more_ = more;
    complete_ = !more;
    if (!more) spare_.clear();
  }
  wake_.notify_one();
}

std::uint64_t LevelBuilder::push(Waiting&& edit) {
  std::uint64_t number;
  {
    const std::lock_guard lock(mutex_);
    number = edit.number = ++applied_;
    if (edit.edit && edit.edit->clear) waiting_.clear();
    if (error_.empty()) waiting_.push_back(std::move(edit));
  }
  wake_.notify_one();
  return number;
}

std::unique_ptr<LevelsUpdate> LevelBuilder::take(bool wait) {
  std::unique_lock lock(mutex_);
  if (wait) rests_.wait(lock, [this] { return waiting_.empty() && !complete_ && !busy_; });
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
    wake_.wait(lock, [this] { return stop_ || complete_ || !waiting_.empty(); });
    if (stop_) return;
    busy_ = true;
    complete_ = false;
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

// Of what waits.
std::optional<LevelBuilder::Waiting> LevelBuilder::takeNext() {
  const std::lock_guard lock(mutex_);
  if (stop_ || waiting_.empty()) return {};
  Waiting next = std::move(waiting_.front());
  waiting_.pop_front();
  if (next.edit && next.edit->clear) update_.reset();
  return next;
}

// Into the slots.
void LevelBuilder::take(const GaussianEdit& edit, const Waiting& as) {
  if (edit.clear) levels_.clear();
  taken_ = as.number;
  slots_.apply(edit, as.now, team_.get());
  levels_.mark(slots_, edit.runs);
}

// Takes what waits, and that into the nodes, until more waits.
void LevelBuilder::build() {
  while (std::optional<Waiting> next = takeNext()) {
    if (next->edit) {
      take(*next->edit, *next);
      continue;
    }
    GaussianEdit edit = editOf(std::move(next->run), team_.get());
    take(edit, *next);
    const std::lock_guard lock(mutex_);
    if (!more_) continue;
    spare_.emplace_back();
    spare_.back().slots = std::move(edit.slots);
    spare_.back().bands = std::move(edit.bands);
    spare_.back().channels = std::move(edit.channels);
  }
  {
    const std::lock_guard lock(mutex_);
    if (more_) return;
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
  update->samples = levels_.samples();
  update->entries.resize(pages.size());
  auto entries = update->entries.begin();
  for (const std::uint32_t first_slot : pages) (entries++)->first = first_slot;
  inParts(team_.get(), pages.size(), [&](std::size_t i) {
    auto& [first_slot, levels] = update->entries[i];
    levels = entriesOf(slots_.at(*slots_.index().find(first_slot)));
  });
  const std::lock_guard lock(mutex_);
  update_ = std::move(update);
}

}  // namespace rosplat
