#include "rosplat_core/map/published_map.hpp"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <random>
#include <stdexcept>

#include "map/harmonics.hpp"
#include "map/named_slots.hpp"
#include "map/page_splats.hpp"
#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/map/slot_revisions.hpp"
#include "rosplat_core/slots/packed_rows.hpp"
#include "rosplat_core/slots/payload.hpp"

namespace rosplat {

namespace {

using Batch = PublishedMap::Batch;

constexpr const char* kNone = "none";
// Most of an answer to a pull: each client, even an idle one, keeps room for some such. [bytes]
constexpr std::size_t kAnswerBytes = 2'000'000;
// Size of a batch without its arrays and channel names, and of a placed group. [bytes]
constexpr std::size_t kBatchBytes = 400, kPlacementBytes = 60;

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

// The highest band of harmonics that has a value other than zero.
int withoutEmptyBands(const SplatArrays<const float>& splats) {
  const std::size_t stride = splats.shStride();
  const auto empty = [&](int degree) {
    for (std::size_t i = 0; i < splats.count; ++i) {
      const float* const sh = splats.sh + stride * i;
      if (std::any_of(sh + harmonicsOf(degree - 1), sh + harmonicsOf(degree),
                      [](float value) { return value != 0; })) {
        return false;
      }
    }
    return true;
  };
  int degree = splats.sh_degree;
  while (degree > 0 && empty(degree)) --degree;
  return degree;
}

std::vector<std::string> namesOf(const SplatsView& splats) {
  std::vector<std::string> names;
  for (const auto& [name, values] : splats.channels) names.push_back(name);
  return names;
}

// A map's known channels and those of a batch's names.
std::vector<std::string> channelsOf(std::vector<std::string> known,
                                    const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    if (std::find(known.begin(), known.end(), name) == known.end()) known.push_back(name);
  }
  if (known.size() > kMostChannels) {
    throw std::invalid_argument("channel_names: " + std::to_string(known.size()) +
                                " in all, a map has at most " + std::to_string(kMostChannels));
  }
  return known;
}

}  // namespace

// A block of slots, at least one of which was ever written.
struct PublishedMap::Page {
  std::uint32_t group = 0;
  std::bitset<kPageSlots> used;
  PageSplats splats;
  SlotRevisions changed{kPageSlots};         // of each slot
  std::uint64_t written = 0, regrouped = 0;  // revisions: any slot's last change, the group's
};

struct PublishedMap::Content {
  struct Frame {
    std::optional<std::array<double, 3>> origin;  // of the group's first splats
    std::optional<Pose> pose;
    std::uint64_t placed = 0;  // revision of the last move
  };

  std::map<std::uint32_t, Page> pages;  // by first slot / kPageSlots
  std::map<std::uint32_t, Frame> groups;
  std::vector<std::string> channels;
  std::size_t used = 0;
  int sh_degree = 0;
  std::optional<bool> antialiased;  // as the first splats
  std::uint32_t expected_slots = 0;

  // Size of a splat in a message. listed: with the slot's number. packed: as a packed row. [bytes]
  static std::size_t splatBytes(int degree, std::size_t channel_count, bool listed,
                                bool packed = false) {
    return (packed ? packed_rows::size(1, degree) : sizeof(float) * (11 + harmonicsOf(degree))) +
           sizeof(float) * channel_count + (listed ? sizeof(std::uint32_t) : 0);
  }
  // The first block, from `first` on, that has slots or the number of a group.
  std::optional<std::uint32_t> blockFrom(std::uint32_t first) const {
    const auto page = pages.lower_bound(first);
    const auto group = groups.lower_bound(first);
    if (page == pages.end() && group == groups.end()) return std::nullopt;
    if (group == groups.end()) return page->first;
    return page == pages.end() ? group->first : std::min(page->first, group->first);
  }
};

// How splats are to be written.
struct PublishedMap::Plan {
  int sh_degree = 0;                  // without empty bands
  std::vector<std::string> channels;  // that the map will have
  std::vector<std::size_t> places;    // in `channels`, of the splats' channels
};

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
      map_(std::make_unique<Content>()) {
  if (chunk_bytes < 1) throw std::invalid_argument("chunk_bytes: at least 1, got 0");
}

PublishedMap::~PublishedMap() = default;

std::uint64_t PublishedMap::revision() const {
  const Lock lock(mutex_);
  return revision_;
}

std::size_t PublishedMap::size() const {
  const Lock lock(mutex_);
  return map_->used;
}

std::vector<PublishedMap::Group> PublishedMap::groups() const {
  const Lock lock(mutex_);
  std::map<std::uint32_t, Slots> used;
  for (const auto& [number, page] : map_->pages) {
    if (page.used.none()) continue;
    Slots& slots = used[page.group];
    for (std::uint32_t i = 0; i < kPageSlots; ++i) {
      if (page.used[i]) slots.push_back(kPageSlots * number + i);
    }
  }
  if (used.empty()) used[0];
  std::vector<Group> groups;
  for (auto& [number, slots] : used) {
    Group& group = groups.emplace_back();
    group.number = number;
    if (const auto found = map_->groups.find(number); found != map_->groups.end()) {
      group.pose = found->second.pose;
    }
    const NamedSlots named(slots.data(), slots.size());
    setFrame(named, group.splats);
    gather(named, map_->sh_degree, group.splats);
    const std::vector<float> values = gatherChannels(named, map_->channels);
    auto first = values.begin();
    for (const std::string& name : map_->channels) {
      const auto end = first + static_cast<std::ptrdiff_t>(slots.size());
      group.splats.channels.emplace_back(name, std::vector<float>(first, end));
      first = end;
    }
    group.slots = std::move(slots);
  }
  return groups;
}

PublishedMap::Poses PublishedMap::poses() const {
  const Lock lock(mutex_);
  return placedAfter(0);
}

// --- Edits ---------------------------------------------------------------------------------------

void PublishedMap::replace(const Splats& splats, std::optional<std::uint32_t> expected_slots,
                           const When& stamp) {
  replace(splats.view(), nullptr, expected_slots, stamp);
}

void PublishedMap::replace(Splats&& splats, std::optional<std::uint32_t> expected_slots,
                           const When& stamp) {
  const auto kept = std::make_shared<const Splats>(std::move(splats));
  replace(kept->view(), kept, expected_slots, stamp);
}

void PublishedMap::replace(const SplatsView& splats, const std::shared_ptr<const void>& keeper,
                           std::optional<std::uint32_t> expected_slots, const When& stamp) {
  splats.check();
  const std::size_t n = splats.arrays.count;
  if (n > kMaxSlots) {
    throw std::invalid_argument(std::to_string(n) + " splats: a map has " +
                                std::to_string(kMaxSlots) + " slots");
  }
  checkNumber("expected_slots", expected_slots.value_or(0), kMaxSlots);
  auto map = std::make_unique<Content>();
  if (keeper) {
    refer(*map, splats, keeper);
  } else {
    const NamedSlots slots(0u, n);
    write(*map, slots, splats, prepared(*map, slots, splats, 0), 0, 0);
  }
  map->expected_slots = expected_slots.value_or(static_cast<std::uint32_t>(map->used));
  Lock turn(turns_), lock(mutex_);
  warnOf(n - map->used);
  std::swap(map_, map);
  try {
    sendMap(turn, lock, stamp, false);
  } catch (...) {
    map_ = std::move(map);
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
  map_->expected_slots = slots;
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
  const std::vector<std::string> channels = namesOf(splats);
  const Lock turn(turns_);
  Lock lock(mutex_);
  const Plan plan = prepared(*map_, slots, splats, group);
  const std::size_t bytes = Content::splatBytes(std::max(plan.sh_degree, map_->sh_degree),
                                                channels.size(), slots.listed());
  const auto parts = slots.parts(std::max<std::size_t>(1, chunk_bytes_ / bytes));
  const Numbering numbering(revision_, parts.size());
  warnOf(write(*map_, slots, splats, plan, group, numbering.last()));
  for (const NamedSlots& part : parts) {
    const auto operation = revision_ > 0 ? GaussianBatch::UPSERT : GaussianBatch::REPLACE;
    send(lock, writing(operation, part, group, map_->sh_degree, channels, stamp));
  }
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
  for (const auto& [number, count] : slots.touched()) {
    const auto found = map_->pages.find(number);
    if (found == map_->pages.end()) continue;
    if (slots.listed() || count < kPageSlots) found->second.changed.reserve();
  }
  const std::size_t most = slots.listed() ? chunk_bytes_ / sizeof(std::uint32_t) : kMaxSlots;
  const auto parts = slots.parts(std::max<std::size_t>(1, most));
  const Numbering numbering(revision_, beginnings() + parts.size());
  const std::uint64_t revision = numbering.last();
  for (std::size_t i = 0; i < slots.size();) {
    const std::uint32_t at = slots[i] % kPageSlots;
    const auto found = map_->pages.find(slots[i] / kPageSlots);
    const std::size_t neighbours =
        slots.listed() ? 1 : std::min<std::size_t>(kPageSlots - at, slots.size() - i);
    i += neighbours;
    if (found == map_->pages.end()) continue;
    Page& page = found->second;
    page.written = revision;
    if (neighbours == kPageSlots) page.changed.fill(revision);
    for (std::uint32_t k = at; k < at + neighbours; ++k) {
      map_->used -= page.used[k];
      page.used[k] = false;
      if (page.changed[k] != revision) page.changed.set(k, revision);
    }
    if (page.used.none()) page.splats = {};
  }
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
  for (const auto& [group, pose] : placed) map_->groups[group];
  const Numbering numbering(revision_, beginnings() + 1);
  for (const auto& [group, pose] : placed) {
    map_->groups[group].pose = pose;
    map_->groups[group].placed = numbering.last();
  }
  begin(lock, stamp);
  send(lock, placement(std::move(placed), stamp));
}

// Checks an edit and allocates its memory. Throws std::invalid_argument if the edit isn't allowed:
// the map is unchanged; or std::bad_alloc: new pages stay, but empty ones do no harm.
PublishedMap::Plan PublishedMap::prepared(Content& map, const NamedSlots& slots,
                                          const SplatsView& splats, std::uint32_t group) {
  Plan plan;
  plan.sh_degree = withoutEmptyBands(splats.arrays);
  plan.channels = channelsOf(map.channels, namesOf(splats));
  for (const auto& [name, values] : splats.channels) {
    const auto place = std::find(plan.channels.begin(), plan.channels.end(), name);
    plan.places.push_back(static_cast<std::size_t>(place - plan.channels.begin()));
  }
  if (slots.empty()) return plan;
  if (map.antialiased.value_or(splats.antialiased) != splats.antialiased) {
    throw std::invalid_argument(
        "antialiased: can't mix antialiased splats with others, they are drawn differently");
  }
  const auto touched = slots.touched();
  for (const auto& [number, count] : touched) {
    const auto found = map.pages.find(number);
    if (found == map.pages.end() || found->second.group == group || found->second.used.none()) {
      continue;
    }
    throw std::invalid_argument("slots " + std::to_string(number * kPageSlots) + " to " +
                                std::to_string(number * kPageSlots + kPageSlots - 1) +
                                " hold splats of group " + std::to_string(found->second.group) +
                                ", this batch is of group " + std::to_string(group) +
                                ": delete them first");
  }
  map.groups[group];
  for (const auto& [number, count] : touched) {
    const auto [found, is_new] = map.pages.try_emplace(number);
    Page& page = found->second;
    if (is_new) page.group = group;
    page.splats.reserve(plan.sh_degree, plan.places);
    if (count < kPageSlots) page.changed.reserve();
  }
  return plan;
}

// Writes the i-th splat to the i-th slot. Returns how many are invalid and left out. plan: from
// prepared() with the same arguments. revision: of the edit's last batch.
std::size_t PublishedMap::write(Content& map, const NamedSlots& slots, const SplatsView& splats,
                                const Plan& plan, std::uint32_t group, std::uint64_t revision) {
  if (slots.empty()) return 0;
  map.channels = plan.channels;
  map.sh_degree = std::max(map.sh_degree, plan.sh_degree);
  map.antialiased = splats.antialiased;
  auto& origin = map.groups[group].origin;
  if (!origin) origin = splats.origin;
  for (const auto& [number, count] : slots.touched()) {
    Page& page = map.pages[number];
    if (page.group != group) page.regrouped = revision;
    page.group = group;
    page.written = revision;
    if (count == kPageSlots) page.changed.fill(revision);
  }
  const SplatArrays<const float>& from = splats.arrays;
  std::size_t left_out = 0;
  std::uint32_t number = kMaxSlots;
  Page* page = nullptr;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (number != slots[i] / kPageSlots) page = &map.pages[number = slots[i] / kPageSlots];
    const std::size_t at = slots[i] % kPageSlots;
    const SplatArrays<float> to = page->splats.own();
    float* const position = to.positions + 3 * at;
    for (int k = 0; k < 3; ++k) {
      const double shift = splats.origin[k] - (*origin)[k];
      position[k] = shift == 0 ? from.positions[3 * i + k]
                               : static_cast<float>(from.positions[3 * i + k] + shift);
    }
    std::copy_n(from.orientations + 4 * i, 4, to.orientations + 4 * at);
    std::copy_n(from.scales + 3 * i, 3, to.scales + 3 * at);
    to.opacities[at] = from.opacities[i];
    copyHarmonics(from.sh + from.shStride() * i, from.sh_degree, to.sh + to.shStride() * at,
                  to.sh_degree);
    for (std::size_t k = 0; k < map.channels.size(); ++k) {
      if (float* const values = page->splats.ownChannel(k)) values[at] = kNoValue;
    }
    for (std::size_t k = 0; k < plan.places.size(); ++k) {
      page->splats.ownChannel(plan.places[k])[at] = splats.channels[k].second[i];
    }
    const bool usable = isUsable(from, i, position);
    left_out += !usable;
    map.used += usable;
    map.used -= page->used[at];
    page->used[at] = usable;
    if (page->changed[at] != revision) page->changed.set(at, revision);
  }
  return left_out;
}

// Fills an empty map with splats that stay in their keeper's memory.
void PublishedMap::refer(Content& map, const SplatsView& splats,
                         const std::shared_ptr<const void>& keeper) {
  map.sh_degree = splats.rows ? splats.arrays.sh_degree : withoutEmptyBands(splats.arrays);
  map.channels = channelsOf({}, namesOf(splats));
  if (splats.arrays.count == 0) return;
  map.antialiased = splats.antialiased;
  map.groups[0].origin = splats.origin;
  for (std::size_t first = 0; first < splats.arrays.count; first += kPageSlots) {
    Page& page = map.pages[static_cast<std::uint32_t>(first / kPageSlots)];
    page.used = page.splats.refer(splats, first, keeper);
    map.used += page.used.count();
  }
}

void PublishedMap::warnOf(std::size_t left_out) {
  if (left_out == 0) return;
  wire_.warn(std::to_string(left_out) +
             " splats are left out: a value is not finite, a scale negative or a quaternion zero");
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
  std::map<std::uint32_t, std::vector<std::uint32_t>> pages;  // by group
  for (auto& [number, page] : map_->pages) {
    if (page.used.any()) pages[page.group].push_back(number);
    page.regrouped = 0;
  }
  if (Poses poses = placedAfter(0); !poses.empty()) {  // first, so that no splat is drawn elsewhere
    send(lock, beginning(stamp));
    for (const auto& [group, pose] : poses) map_->groups[group].placed = revision_ + 1;
    send(lock, placement(std::move(poses), stamp));
  }
  Slots slots;
  bool ended = false;
  const auto flush = [&](std::uint32_t group) {
    const NamedSlots named(slots.data(), slots.size());
    auto slot = slots.begin();
    for (const auto& [number, count] : named.touched()) {
      Page& page = map_->pages.at(number);
      page.written = revision_ + 1;
      if (count == kPageSlots) page.changed.fill(page.written);
      for (const auto end = slot + count; slot != end; ++slot) {
        if (count < kPageSlots) page.changed.set(*slot % kPageSlots, page.written);
      }
    }
    const auto operation = revision_ < begun ? GaussianBatch::REPLACE : GaussianBatch::UPSERT;
    Batch batch = writing(operation, named, group, map_->sh_degree, map_->channels, stamp);
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
  for (const auto& [group, numbers] : pages) {
    bool listed = false;
    for (const std::uint32_t number : numbers) {
      for (std::uint32_t i = 0; i < kPageSlots && !ended; ++i) {
        // A block that went to another group meanwhile was sent when that was written.
        const Page& page = map_->pages.at(number);
        if (!page.used[i] || page.group != group) continue;
        const std::uint32_t slot = kPageSlots * number + i;
        const bool gap = !slots.empty() && slots.back() + 1 != slot;
        const std::size_t bytes =
            Content::splatBytes(map_->sh_degree, map_->channels.size(), listed || gap);
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

// Calls each(page, place in the page, i) for the i-th slot. The pages must exist.
template <typename Each>
void PublishedMap::forEach(const NamedSlots& slots, const Each& each) const {
  std::uint32_t number = kMaxSlots;
  const Page* page = nullptr;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (number != slots[i] / kPageSlots) page = &map_->pages.at(number = slots[i] / kPageSlots);
    each(*page, slots[i] % kPageSlots, i);
  }
}

// Fills arrays with the splats of slots, all of one group.
void PublishedMap::gather(const NamedSlots& slots, int sh_degree, Splats& splats) const {
  const std::size_t n = slots.size();
  splats.positions.resize(3 * n);
  splats.orientations.resize(4 * n);
  splats.scales.resize(3 * n);
  splats.opacities.resize(n);
  splats.sh.resize(harmonicsOf(sh_degree) * n);
  forEach(slots, [&](const Page& page, std::size_t at, std::size_t i) {
    page.splats.read(at, i, sh_degree, splats);
  });
}

// Fills a payload with the packed rows of slots. Returns false if not all slots are packed.
bool PublishedMap::gatherRows(const NamedSlots& slots, int sh_degree,
                              std::vector<std::uint8_t>& payload) const {
  const std::size_t bytes = packed_rows::size(1, sh_degree);
  payload.resize(bytes * slots.size());
  bool packed = slots.size() > 0;
  forEach(slots, [&](const Page& page, std::size_t at, std::size_t i) {
    packed = packed && page.splats.readRow(at, sh_degree, payload.data() + bytes * i);
  });
  if (!packed) payload = {};
  return packed;
}

// The slots' values of some of the map's channels, channel by channel.
std::vector<float> PublishedMap::gatherChannels(const NamedSlots& slots,
                                                const std::vector<std::string>& channels) const {
  const std::size_t n = slots.size();
  std::vector<float> values(channels.size() * n, kNoValue);
  for (std::size_t k = 0; k < channels.size(); ++k) {
    const auto found = std::find(map_->channels.begin(), map_->channels.end(), channels[k]);
    const auto place = static_cast<std::size_t>(found - map_->channels.begin());
    forEach(slots, [&](const Page& page, std::size_t at, std::size_t i) {
      if (const float* const own = page.splats.channel(place)) values[n * k + i] = own[at];
    });
  }
  return values;
}

void PublishedMap::setFrame(const NamedSlots& slots, Splats& splats) const {
  splats.antialiased = map_->antialiased.value_or(false);
  if (slots.size() == 0) return;
  const auto& origin = map_->groups.at(map_->pages.at(slots[0] / kPageSlots).group).origin;
  if (origin) splats.origin = *origin;
}

PublishedMap::Poses PublishedMap::placedAfter(std::uint64_t revision) const {
  Poses poses;
  for (const auto& [group, frame] : map_->groups) {
    if (frame.pose && frame.placed > revision) poses.emplace(group, *frame.pose);
  }
  return poses;
}

Batch PublishedMap::batch(std::uint8_t operation, const When& stamp) const {
  Batch batch;
  batch.stamp = stamp;
  batch.map_id = map_id_;
  batch.revision = revision_;
  batch.operation = operation;
  batch.expected_slots = map_->expected_slots;
  return batch;
}

Batch PublishedMap::beginning(const When& stamp) const {
  Batch beginning = batch(GaussianBatch::REPLACE, stamp);
  beginning.sh_degree = map_->sh_degree;
  beginning.splats.antialiased = map_->antialiased.value_or(false);
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
  writing.sh_degree = sh_degree;
  writing.channel_names = channels;
  writing.channels = gatherChannels(slots, channels);
  setFrame(slots, writing.splats);
  if (compression_ == kNone && gatherRows(slots, sh_degree, writing.payload)) {
    writing.format = packed_rows::kFormat;
    return writing;
  }
  gather(slots, sh_degree, writing.splats);
  if (compression_ == kNone) return writing;
  const SplatArrays<const float> arrays = writing.splats.view().arrays;
  std::vector<bool> usable(arrays.count);
  for (std::size_t i = 0; i < usable.size(); ++i) {
    usable[i] = isUsable(arrays, i, arrays.positions + 3 * i);
  }
  if (!payload::suits(arrays, usable)) return writing;
  writing.format = payload::kFormat;
  writing.payload.resize(payload::size(arrays.count, arrays.sh_degree));
  payload::encode(arrays, usable, writing.payload.data());
  Splats& sent = writing.splats;
  for (auto* array : {&sent.positions, &sent.orientations, &sent.scales, &sent.opacities, &sent.sh})
    *array = {};
  return writing;
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
  Poses poses;
  Slots emptied;
  std::map<std::pair<std::uint32_t, bool>, Slots> written;  // by group, and whether packed
  std::size_t names = 0;
  for (const std::string& name : map_->channels) names += name.size() + 8;
  const int sh_degree = std::min(map_->sh_degree, most_sh_degree);
  const std::size_t most_bytes = std::min(chunk_bytes_, kAnswerBytes);
  std::size_t bytes = 3 * kBatchBytes;
  bool begun = false;
  for (auto block = map_->blockFrom(first_block); block; block = map_->blockFrom(*block + 1)) {
    // Each block brings its splats, the pose of their group, and the pose of the group that has the
    // block's number. So all poses come, and none after its splats.
    Poses placed;
    const auto place = [&](std::uint32_t group) {
      const auto found = map_->groups.find(group);
      if (found == map_->groups.end() || !found->second.pose || poses.count(group) > 0) return;
      if (found->second.placed > after) placed.emplace(group, *found->second.pose);
    };
    place(*block);
    Slots to_empty, to_write;
    std::uint32_t group = 0;
    bool packed = false;
    const auto found = map_->pages.find(*block);
    if (found != map_->pages.end() && (after == 0 || found->second.written > after)) {
      const Page& page = found->second;
      group = page.group;
      packed = compression_ == kNone && page.splats.packed();
      place(group);
      for (std::uint32_t i = 0; i < kPageSlots; ++i) {
        const bool changed = after == 0 || page.changed[i] > after;
        const std::uint32_t slot = kPageSlots * *block + i;
        if (changed && page.used[i]) to_write.push_back(slot);
        if (after > 0 && (page.regrouped > after || (changed && !page.used[i]))) {
          to_empty.push_back(slot);
        }
      }
    }
    const std::size_t splat_bytes =
        Content::splatBytes(sh_degree, map_->channels.size(), true, packed);
    std::size_t more = kPlacementBytes * placed.size() + sizeof(std::uint32_t) * to_empty.size() +
                       splat_bytes * to_write.size();
    if (more == 0) continue;
    const std::pair kind(group, packed);
    if (!to_write.empty() && written.count(kind) == 0) more += kBatchBytes + names;
    if (begun && bytes + more > most_bytes) {
      answer.next_block = *block;
      break;
    }
    begun = true;
    bytes += more;
    poses.merge(placed);
    emptied.insert(emptied.end(), to_empty.begin(), to_empty.end());
    if (to_write.empty()) continue;
    Slots& slots = written[kind];
    slots.insert(slots.end(), to_write.begin(), to_write.end());
  }
  auto& batches = answer.batches;
  if (first_block == 0 && after == 0) batches.push_back(beginning(std::nullopt));
  if (!poses.empty()) batches.push_back(placement(std::move(poses), std::nullopt));
  if (!emptied.empty()) {
    batches.push_back(deletion({emptied.data(), emptied.size()}, std::nullopt));
  }
  for (const auto& [kind, slots] : written) {
    batches.push_back(writing(GaussianBatch::UPSERT, {slots.data(), slots.size()}, kind.first,
                              sh_degree, map_->channels, std::nullopt));
  }
  if (batches.empty()) {
    batches.push_back(
        writing(GaussianBatch::UPSERT, NamedSlots(), 0, sh_degree, map_->channels, std::nullopt));
  }
  for (Batch& batch : batches) {
    if (batch.expected_slots == 0) batch.expected_slots = static_cast<std::uint32_t>(map_->used);
  }
  return answer;
}

}  // namespace rosplat
