#include "rosplat_core/levels/level_builder.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <set>
#include <utility>

#include "rosplat_core/threads/clock.hpp"
#include "rosplat_core/threads/give_way.hpp"
#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

namespace {

constexpr double kLeastTime = 0.05;  // of building, even if edits wait [s]
constexpr std::uint64_t kNever = std::numeric_limits<std::uint64_t>::max();

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
    : team_(ThreadTeam::ofViewers()), levels_(team_), thread_([this] { run(); }) {}

LevelBuilder::~LevelBuilder() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

std::uint64_t LevelBuilder::apply(std::shared_ptr<const GaussianEdit> edit, double now) {
  MapState state;
  EditQueue::Node node = EditQueue::node(std::move(edit), state, now);
  std::uint64_t number;
  {
    const std::lock_guard lock(mutex_);
    number = node.front().state.edits = ++applied_;
    if (node.front().edit->clear) dropRuns();
    if (error_.empty()) edits_.push(std::move(node));
  }
  wake_.notify_one();
  return number;
}

std::uint64_t LevelBuilder::apply(PackedRun run, double now) {
  std::uint64_t number;
  {
    const std::lock_guard lock(mutex_);
    number = ++applied_;
    if (error_.empty()) {
      runs_bytes_ += run.bytes();
      runs_.push_back({std::move(run), now, number});
    }
  }
  wake_.notify_one();
  return number;
}

void LevelBuilder::dropRuns() {
  runs_.clear();
  runs_bytes_ = 0;
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

std::unique_ptr<LevelsUpdate> LevelBuilder::update(bool wait) {
  std::unique_lock lock(mutex_);
  if (wait) rests_.wait(lock, [this] { return !waits() && !complete_ && !busy_; });
  return std::move(update_);
}

std::size_t LevelBuilder::bytes() const {
  const std::lock_guard lock(mutex_);
  std::size_t spare = 0;
  for (const PackedRun& run : spare_) spare += run.bytes();
  return bytes_ + edits_.bytes() + runs_bytes_ + spare;
}

std::string LevelBuilder::error() const {
  const std::lock_guard lock(mutex_);
  return error_;
}

void LevelBuilder::run() {
  giveWay();
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return stop_ || complete_ || waits(); });
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
      edits_.clear();
      dropRuns();
    }
    busy_ = false;
    rests_.notify_all();
    lock.unlock();
    const std::size_t bytes = slots_.bytes() + levels_.bytes();
    lock.lock();
    bytes_ = bytes;
  }
}

// Applies an edit to the slots.
void LevelBuilder::insert(const GaussianEdit& edit, double now, std::uint64_t number) {
  if (edit.clear) levels_.clear();
  taken_ = number;
  slots_.apply(edit, now, team_.get());
  levels_.mark(slots_, edit.runs);
}

void LevelBuilder::insert(Run run) {
  GaussianEdit edit = editOf(std::move(run.run), team_.get());
  insert(edit, run.now, run.number);
  const std::lock_guard lock(mutex_);
  if (!more_) return;
  static_cast<SlotArrays&>(spare_.emplace_back()) = std::move(edit);
}

// Takes over all edits and runs that wait by now, in the order of their numbers.
void LevelBuilder::takeWaiting() {
  std::unique_lock lock(mutex_);
  const std::uint64_t last = applied_;
  while (!stop_ && waits()) {
    const std::uint64_t edit = edits_.empty() ? kNever : edits_.front().state.edits;
    const std::uint64_t run = runs_.empty() ? kNever : runs_.front().number;
    if (std::min(edit, run) > last) break;
    if (edit < run) {
      const EditQueue::Waiting next = edits_.pop();
      if (next.edit->clear) update_.reset();
      lock.unlock();
      insert(*next.edit, next.now, edit);
    } else {
      Run next = std::move(runs_.front());
      runs_.pop_front();
      runs_bytes_ -= next.run.bytes();
      lock.unlock();
      insert(std::move(next));
    }
    lock.lock();
  }
  lock.unlock();
  const std::size_t bytes = slots_.bytes() + levels_.bytes();
  lock.lock();
  bytes_ = bytes;
}

// Whether building must stop. had_time: building had its share of time.
bool LevelBuilder::isInterrupted(bool had_time) const {
  const std::lock_guard lock(mutex_);
  const bool clears = !edits_.empty() && edits_.front().edit->clear;
  return stop_ || clears || (had_time && waits());
}

// Takes over what waits, then builds nodes; if more waits, only for as long as taking over took.
void LevelBuilder::build() {
  const double begin = now();
  takeWaiting();
  {
    const std::lock_guard lock(mutex_);
    if (more_ || !runs_.empty()) return;
  }
  const double from = now();
  const double until = from + std::max(from - begin, kLeastTime);
  std::vector<std::uint32_t> changed;  // pages, since the last handOver()
  double next = from;
  levels_.advance(
      slots_, [&] { return isInterrupted(now() >= until); },
      [&](const std::vector<std::uint32_t>& pages) {
        changed.insert(changed.end(), pages.begin(), pages.end());
        const double start = now();
        if (start < next) return;
        handOver(changed);
        changed.clear();
        // It copies the lists of all groups, so it gets a tenth of the time.
        const double end = now();
        next = end + 9 * (end - start);
      });
  if (!changed.empty()) handOver(changed);
}

void LevelBuilder::handOver(const std::vector<std::uint32_t>& changed) {
  std::set<std::uint32_t> pages(changed.begin(), changed.end());
  {
    const std::lock_guard lock(mutex_);
    // Pages of an update that nobody took go into this one: they may have been written since.
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
