#include "rosplat_core/map/published_map.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <random>
#include <stdexcept>

#include "map/published_content.hpp"
#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/slots/packed_rows.hpp"
#include "rosplat_core/slots/payload.hpp"

namespace rosplat {

namespace {

using Batch = PublishedMap::Batch;

constexpr const char* kNone = "none";
// Most of an answer to a pull: each client, even an idle one, keeps room for some such. [bytes]
constexpr std::size_t kAnswerBytes = 2'000'000;

std::string checkedCompression(const std::string& compression) {
  if (compression == kNone || compression == payload::kFormat) return compression;
  throw std::invalid_argument(std::string("compression: expected one of ") + kNone + ", " +
                              payload::kFormat + ", got '" + compression + "'");
}

std::string randomId() {
  std::random_device random;
  std::string id;
  for (int i = 0; i < 32; ++i) id += "0123456789abcdef"[random() % 16];
  return id;
}

void checkNumber(const char* name, std::uint64_t number, std::uint64_t most) {
  if (number <= most) return;
  throw std::invalid_argument(std::string(name) + ": a number from 0 to " + std::to_string(most) +
                              ", got " + std::to_string(number));
}

void checkGroup(std::uint32_t group) { checkNumber("group", group, kMostGroups - 1); }

// The pose with a quaternion of unit length. Throws std::invalid_argument for an invalid one.
Pose checkedPose(Pose pose, std::uint32_t group) {
  auto& q = pose.orientation;
  const double length = std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
  for (const double value : {pose.position[0], pose.position[1], pose.position[2], length}) {
    if (std::isfinite(value) && length > 0) continue;
    throw std::invalid_argument("poses[" + std::to_string(group) +
                                "]: not finite, or a quaternion of length zero");
  }
  for (double& value : q) value /= length;
  return pose;
}

}  // namespace

// Reserves an edit's revisions, even if sending fails: receivers then see a gap and pull.
class PublishedMap::Numbering {
 public:
  Numbering(std::uint64_t& revision, std::size_t batches)
      : revision_(revision), last_(revision + batches) {}
  Numbering(const Numbering&) = delete;
  Numbering& operator=(const Numbering&) = delete;
  ~Numbering() { revision_ = last_; }

  std::uint64_t last() const { return last_; }

 private:
  std::uint64_t& revision_;
  const std::uint64_t last_;
};

PublishedMap::PublishedMap(std::size_t chunk_bytes, const std::string& compression, Wire wire)
    : chunk_bytes_(chunk_bytes),
      compression_(checkedCompression(compression)),
      wire_(std::move(wire)),
      map_id_(randomId()),
      map_(std::make_unique<PublishedContent>()) {
  if (chunk_bytes < 1) throw std::invalid_argument("chunk_bytes: at least 1, got 0");
}

PublishedMap::~PublishedMap() = default;

std::uint64_t PublishedMap::revision() const {
  const Lock lock(mutex_);
  return revision_;
}

std::size_t PublishedMap::size() const {
  const Lock lock(mutex_);
  return map_->used();
}

std::vector<PublishedMap::Group> PublishedMap::groups() const {
  const Lock lock(mutex_);
  return map_->groups();
}

PublishedMap::Poses PublishedMap::poses() const {
  const Lock lock(mutex_);
  return map_->placedAfter(0);
}

PublishedMap::Batch PublishedMap::copy(const Slots& slots, std::uint32_t group) const {
  const Lock lock(mutex_);
  Slots held;
  std::copy_if(slots.begin(), slots.end(), std::back_inserter(held),
               [&](std::uint32_t slot) { return map_->holds(slot, group); });
  return writing(GaussianBatch::UPSERT, {held.data(), held.size()}, group, map_->shDegree(),
                 map_->channels(), std::nullopt);
}

// --- Edits ---------------------------------------------------------------------------------------

void PublishedMap::replace(const Splats& splats, std::optional<std::uint32_t> expected,
                           const When& stamp) {
  replace(splats.view(), nullptr, expected, stamp);
}

void PublishedMap::replace(const SplatsView& splats, const std::shared_ptr<const void>& keeper,
                           std::optional<std::uint32_t> expected, const When& stamp) {
  splats.check();
  const std::size_t n = splats.arrays.count;
  if (n > kMaxSlots) {
    throw std::invalid_argument(std::to_string(n) + " splats: a map has " +
                                std::to_string(kMaxSlots) + " slots");
  }
  checkNumber("expected_slots", expected.value_or(0), kMaxSlots);
  const bool in_place = keeper && splats.rows;
  auto map = in_place ? std::make_unique<PublishedContent>(splats, keeper)
                      : std::make_unique<PublishedContent>();
  if (!in_place) {
    const NamedSlots slots(0u, n);
    map->write(slots, splats, map->prepareWrite(slots, splats, 0), 0, 0);
  }
  std::uint32_t announced = expected.value_or(static_cast<std::uint32_t>(map->used()));
  Lock turn(turns_), lock(mutex_);
  warnOf(n - map->used());
  std::swap(map_, map);
  std::swap(expected_, announced);
  try {
    sendMap(turn, lock, stamp, false);
  } catch (...) {
    map_ = std::move(map);
    expected_ = announced;
    try {  // for receivers that have got a part of the new map; if this fails, they pull
      sendMap(turn, lock, stamp, false);
    } catch (const std::exception&) {
    }
    throw;
  }
}

void PublishedMap::repeat() {
  Lock turn(turns_), lock(mutex_);
  sendMap(turn, lock, std::nullopt, true);
}

void PublishedMap::expect(std::uint32_t slots) {
  checkNumber("expected_slots", slots, kMaxSlots);
  const Lock lock(mutex_);
  expected_ = slots;
}

void PublishedMap::upsert(const Slots& slots, const Splats& splats, std::uint32_t group,
                          const When& stamp) {
  upsert(slots, splats.view(), group, stamp);
}

void PublishedMap::upsert(std::uint32_t first_slot, const Splats& splats, std::uint32_t group,
                          const When& stamp) {
  upsert(first_slot, splats.view(), group, stamp);
}

void PublishedMap::upsert(const Slots& slots, const SplatsView& splats, std::uint32_t group,
                          const When& stamp) {
  upsert(NamedSlots::checked(slots), splats, group, stamp);
}

void PublishedMap::upsert(std::uint32_t first_slot, const SplatsView& splats, std::uint32_t group,
                          const When& stamp) {
  upsert(NamedSlots::checked(first_slot, splats.arrays.count), splats, group, stamp);
}

void PublishedMap::upsert(const NamedSlots& slots, const SplatsView& splats, std::uint32_t group,
                          const When& stamp) {
  splats.check();
  checkGroup(group);
  if (slots.size() != splats.arrays.count) {
    throw std::invalid_argument("slots: " + std::to_string(splats.arrays.count) + " splats for " +
                                std::to_string(slots.size()) + " slots");
  }
  std::vector<std::string> channels;
  for (const auto& [name, values] : splats.channels) channels.push_back(name);
  const Lock turn(turns_);
  Lock lock(mutex_);
  const PublishedContent::Plan plan = map_->prepareWrite(slots, splats, group);
  const std::size_t bytes = PublishedContent::splatBytes(std::max(plan.sh_degree, map_->shDegree()),
                                                         channels.size(), slots.listed());
  const auto parts = slots.parts(std::max<std::size_t>(1, chunk_bytes_ / bytes));
  const Numbering numbering(revision_, parts.size());
  warnOf(map_->write(slots, splats, plan, group, numbering.last()));
  for (const NamedSlots& part : parts) {
    const auto operation = revision_ > 0 ? GaussianBatch::UPSERT : GaussianBatch::REPLACE;
    send(lock, writing(operation, part, group, map_->shDegree(), channels, stamp));
  }
}

PublishedMap::Slots PublishedMap::append(const Splats& splats, std::uint32_t group,
                                         const When& stamp) {
  return append(splats.view(), group, stamp);
}

PublishedMap::Slots PublishedMap::append(const SplatsView& splats, std::uint32_t group,
                                         const When& stamp) {
  checkGroup(group);
  const Lock turn(turns_);  // no other edit comes between the choice and the writing
  Slots slots;
  {
    const Lock lock(mutex_);
    slots = map_->freeSlots(splats.arrays.count, group);
  }
  upsert(slots, splats, group, stamp);
  return slots;
}

void PublishedMap::erase(const Slots& slots, const When& stamp) {
  erase(NamedSlots::checked(slots), stamp);
}

void PublishedMap::erase(std::uint32_t first_slot, std::uint32_t count, const When& stamp) {
  erase(NamedSlots::checked(first_slot, count), stamp);
}

void PublishedMap::erase(const NamedSlots& slots, const When& stamp) {
  const Lock turn(turns_);
  Lock lock(mutex_);
  map_->prepareErase(slots);
  const std::size_t most = slots.listed() ? chunk_bytes_ / sizeof(std::uint32_t) : kMaxSlots;
  const auto parts = slots.parts(std::max<std::size_t>(1, most));
  const Numbering numbering(revision_, beginnings() + parts.size());
  map_->erase(slots, numbering.last());
  begin(lock, stamp);
  for (const NamedSlots& part : parts) send(lock, deletion(part, stamp));
}

void PublishedMap::move(const Poses& poses, const When& stamp) {
  Poses placed;
  for (const auto& [group, pose] : poses) {
    checkGroup(group);
    placed.emplace(group, checkedPose(pose, group));
  }
  if (placed.empty()) return;
  const Lock turn(turns_);
  Lock lock(mutex_);
  map_->preparePlace(placed);
  const Numbering numbering(revision_, beginnings() + 1);
  map_->place(placed, numbering.last());
  begin(lock, stamp);
  send(lock, placement(std::move(placed), stamp));
}

void PublishedMap::warnOf(std::size_t left_out) {
  if (left_out == 0) return;
  wire_.warn(std::to_string(left_out) +
             " splats are left out: a value is not finite, a scale negative (a logarithm?) or a "
             "quaternion zero");
}

// --- Sending -------------------------------------------------------------------------------------

// Sends the whole map, from its beginning. waits: after each batch, for the subscribers; other
// threads may edit the map meanwhile. If sending fails, all receivers have to pull the whole map.
void PublishedMap::sendMap(Lock& turn, Lock& lock, const When& stamp, bool waits) {
  const std::uint64_t begun = begun_ = revision_ + 1;
  try {
    sendSplats(turn, lock, stamp, waits);
  } catch (...) {
    if (!turn.owns_lock()) turn.lock();
    if (!lock.owns_lock()) lock.lock();
    if (begun_ == begun) begun_ = ++revision_;
    throw;
  }
}

void PublishedMap::sendSplats(Lock& turn, Lock& lock, const When& stamp, bool waits) {
  const std::uint64_t begun = begun_;
  const auto blocks = map_->beginSending();
  if (Poses poses = map_->placedAfter(0);
      !poses.empty()) {  // first, so that no splat is drawn elsewhere
    send(lock, beginning(stamp));
    map_->place(poses, revision_ + 1);
    send(lock, placement(std::move(poses), stamp));
  }
  Slots slots;
  bool ended = false;
  const auto flush = [&](std::uint32_t group) {
    const NamedSlots named(slots.data(), slots.size());
    map_->touch(named, revision_ + 1);
    const auto operation = revision_ < begun ? GaussianBatch::REPLACE : GaussianBatch::UPSERT;
    Batch batch = writing(operation, named, group, map_->shDegree(), map_->channels(), stamp);
    slots.clear();
    send(lock, std::move(batch));
    if (waits) {
      lock.unlock();
      turn.unlock();
      wire_.settle();
      turn.lock();
      lock.lock();
    }
    ended = begun_ != begun;  // another thread has begun to send all
  };
  for (const auto& [group, numbers] : blocks) {
    bool listed = false;
    for (const std::uint32_t number : numbers) {
      for (std::uint32_t i = 0; i < kPageSlots && !ended; ++i) {
        const std::uint32_t slot = kPageSlots * number + i;
        // A block that went to another group meanwhile was sent when that was written.
        if (!map_->holds(slot, group)) continue;
        const bool gap = !slots.empty() && slots.back() + 1 != slot;
        const std::size_t bytes =
            PublishedContent::splatBytes(map_->shDegree(), map_->channels().size(), listed || gap);
        if (!slots.empty() && (slots.size() + 1) * bytes > chunk_bytes_) {
          flush(group);
          if (ended) return;
          --i;  // look again: the slot may have changed meanwhile
          listed = false;
          continue;
        }
        listed = listed || gap;
        slots.push_back(slot);
      }
    }
    if (!slots.empty()) flush(group);
    if (ended) return;
  }
  if (revision_ < begun) flush(0);  // no splats
}

// How many batches must precede an edit without splats: each map begins with a REPLACE. When a bag
// loops, this REPLACE empties the map of the previous round.
std::size_t PublishedMap::beginnings() const { return revision_ > 0 ? 0 : 1; }

void PublishedMap::begin(Lock& lock, const When& stamp) {
  if (beginnings() > 0) send(lock, beginning(stamp));
}

// Other edits wait for their turn meanwhile; pulls and getters don't wait.
void PublishedMap::send(Lock& lock, Batch&& batch) {
  batch.revision = ++revision_;
  lock.unlock();
  try {
    wire_.send(std::move(batch));
  } catch (...) {
    lock.lock();
    throw;
  }
  lock.lock();
}

// --- Batches, of the revision that the map has now -----------------------------------------------

Batch PublishedMap::batch(std::uint8_t operation, const When& stamp) const {
  Batch batch;
  batch.stamp = stamp;
  batch.map_id = map_id_;
  batch.revision = revision_;
  batch.operation = operation;
  batch.expected_slots = expected_;
  return batch;
}

Batch PublishedMap::beginning(const When& stamp) const {
  Batch beginning = batch(GaussianBatch::REPLACE, stamp);
  beginning.sh_degree = static_cast<std::uint8_t>(map_->shDegree());
  beginning.model = static_cast<std::uint8_t>(map_->model());
  return beginning;
}

Batch PublishedMap::writing(std::uint8_t operation, const NamedSlots& slots, std::uint32_t group,
                            int sh_degree, const std::vector<std::string>& channels,
                            const When& stamp) const {
  Batch writing = batch(operation, stamp);
  writing.first_slot = slots.first();
  writing.count = static_cast<std::uint32_t>(slots.size());
  writing.slots = slots.list();
  writing.group = group;
  writing.sh_degree = static_cast<std::uint8_t>(sh_degree);
  writing.channel_names = channels;
  writing.channels = map_->readChannels(slots, channels);
  writing.model = static_cast<std::uint8_t>(map_->model());
  writing.origin = map_->originOf(group);
  if (slots.empty()) return writing;
  if (compression_ == payload::kFormat && quantise(slots, writing)) return writing;
  writing.format = packed_rows::kFormat;
  writing.payload = map_->readRows(slots, sh_degree);
  return writing;
}

// Fills a batch's payload. Returns false if its splats differ too much from each other for that.
bool PublishedMap::quantise(const NamedSlots& slots, Batch& batch) const {
  Splats splats;
  map_->read(slots, batch.sh_degree, splats);
  const SplatArrays<const float> arrays = splats.view().arrays;
  std::vector<bool> usable(arrays.count);
  for (std::size_t i = 0; i < usable.size(); ++i) {
    usable[i] = isUsable(arrays, i, arrays.positions + 3 * i);
  }
  if (!payload::suits(arrays, usable)) return false;
  batch.format = payload::kFormat;
  batch.payload.resize(payload::size(arrays.count, arrays.sh_degree));
  payload::encode(arrays, usable, batch.payload.data());
  return true;
}

Batch PublishedMap::deletion(const NamedSlots& slots, const When& stamp) const {
  Batch deletion = batch(GaussianBatch::DELETE, stamp);
  deletion.first_slot = slots.first();
  deletion.count = static_cast<std::uint32_t>(slots.size());
  deletion.slots = slots.list();
  return deletion;
}

Batch PublishedMap::placement(Poses poses, const When& stamp) const {
  Batch placement = batch(GaussianBatch::MOVE, stamp);
  placement.poses = std::move(poses);
  return placement;
}

// --- Pulls ---------------------------------------------------------------------------------------

PublishedMap::Answer PublishedMap::pull(const std::string& map_id, std::uint64_t after,
                                        std::uint32_t first_block, int most_sh_degree) const {
  Answer answer;
  const Lock lock(mutex_);
  const bool meant = map_id.empty() || map_id == map_id_;
  if (!meant || revision_ == 0) return answer;
  if (after < begun_ || after > revision_) {
    // A client that knew no revision goes on at its block: its next round asks for the new map.
    if (after > 0) first_block = 0;
    after = 0;
  }
  const int sh_degree = std::min(map_->shDegree(), most_sh_degree);
  PublishedContent::Changes changes =
      map_->changes(after, first_block, {std::min(chunk_bytes_, kAnswerBytes), sh_degree});
  answer.next_block = changes.next_block;
  auto& batches = answer.batches;
  if (first_block == 0 && after == 0) batches.push_back(beginning(std::nullopt));
  if (!changes.poses.empty()) {
    batches.push_back(placement(std::move(changes.poses), std::nullopt));
  }
  if (!changes.emptied.empty()) {
    batches.push_back(deletion({changes.emptied.data(), changes.emptied.size()}, std::nullopt));
  }
  for (const auto& [group, slots] : changes.written) {
    batches.push_back(writing(GaussianBatch::UPSERT, {slots.data(), slots.size()}, group, sh_degree,
                              map_->channels(), std::nullopt));
  }
  if (batches.empty()) {
    batches.push_back(
        writing(GaussianBatch::UPSERT, NamedSlots(), 0, sh_degree, map_->channels(), std::nullopt));
  }
  for (Batch& batch : batches) {
    if (batch.expected_slots == 0) batch.expected_slots = static_cast<std::uint32_t>(map_->used());
  }
  return answer;
}

}  // namespace rosplat
