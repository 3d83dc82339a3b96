#include "rosplat_tools/published_map.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>
#include <stdexcept>
#include <utility>

#include "rosplat_core/slots/payload.hpp"
#include "rosplat_core/slots/splat_arrays.hpp"

namespace rosplat {

namespace {

using Batch = PublishedMap::Batch;

constexpr const char* kNone = "none";

std::size_t coefficients(int sh_degree) { return 3u * (sh_degree + 1u) * (sh_degree + 1u); }

MapOptions checked(MapOptions options) {
  if (options.chunk_bytes < 1) throw std::invalid_argument("chunk_bytes: at least 1, got 0");
  if (options.compression != kNone && options.compression != payload::kFormat) {
    throw std::invalid_argument(std::string("compression: expected one of ") + kNone + ", " +
                                payload::kFormat + ", got '" + options.compression + "'");
  }
  return options;
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

void checkGroup(std::uint32_t group) { checkNumber("group", group, Batch::MAX_GROUPS - 1); }

void checkSlot(const char* name, std::uint64_t slot) {
  if (slot < Batch::MAX_SLOTS) return;
  throw std::invalid_argument(std::string(name) + ": a slot is a number from 0 to " +
                              std::to_string(Batch::MAX_SLOTS - 1) + ", got " +
                              std::to_string(slot));
}

void checkSlots(const PublishedMap::Slots& slots) {
  for (const std::uint32_t slot : slots) checkSlot("slots", slot);
  if (std::adjacent_find(slots.begin(), slots.end(), std::greater_equal<>()) == slots.end()) return;
  PublishedMap::Slots ascending = slots;
  std::sort(ascending.begin(), ascending.end());
  if (std::adjacent_find(ascending.begin(), ascending.end()) != ascending.end()) {
    throw std::invalid_argument("slots: each slot may be named once");
  }
}

// Of so many slots from the first on.
std::uint64_t checkedEnd(std::uint32_t first, std::size_t count) {
  const std::uint64_t end = first + std::uint64_t{count};
  if (count > 0) checkSlot("first_slot", end - 1);
  return end;
}

PublishedMap::Slots neighbours(std::uint32_t first, std::size_t count) {
  checkedEnd(first, count);
  PublishedMap::Slots slots(count);
  std::iota(slots.begin(), slots.end(), first);
  return slots;
}

// With a quaternion of unit length.
PublishedMap::Pose checked(PublishedMap::Pose pose, std::uint32_t group) {
  auto& p = pose.position;
  auto& q = pose.orientation;
  const double length = std::hypot(std::hypot(q.x, q.y), std::hypot(q.z, q.w));
  for (const double value : {p.x, p.y, p.z, length}) {
    if (std::isfinite(value) && length > 0) continue;
    throw std::invalid_argument("poses[" + std::to_string(group) +
                                "]: not finite, or a quaternion of length zero");
  }
  for (double* const value : {&q.x, &q.y, &q.z, &q.w}) *value /= length;
  return pose;
}

// The highest band of harmonics that isn't zero in all of the splats.
int withoutEmptyBands(const Splats& splats, int sh_degree) {
  const std::size_t stride = coefficients(sh_degree);
  const auto empty = [&](int degree) {
    for (std::size_t i = 0; i < splats.size(); ++i) {
      const float* const sh = &splats.sh[stride * i];
      if (std::any_of(sh + coefficients(degree - 1), sh + coefficients(degree),
                      [](float value) { return value != 0; })) {
        return false;
      }
    }
    return true;
  };
  while (sh_degree > 0 && empty(sh_degree)) --sh_degree;
  return sh_degree;
}

std::vector<std::string> namesOf(const Splats& splats) {
  std::vector<std::string> names;
  for (const auto& [name, values] : splats.channels) names.push_back(name);
  return names;
}

// The channels of a map that had some, once it is written with others, too.
std::vector<std::string> joined(std::vector<std::string> known,
                                const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    if (std::find(known.begin(), known.end(), name) == known.end()) known.push_back(name);
  }
  if (known.size() > Batch::MAX_CHANNELS) {
    throw std::invalid_argument("channel_names: " + std::to_string(known.size()) +
                                " in all, a map has at most " +
                                std::to_string(Batch::MAX_CHANNELS));
  }
  return known;
}

// Gives room for slots, bands and channels, what is there staying where it is.
void makeRoom(Splats& splats, std::size_t slots, int& sh_degree, int new_degree,
              const std::vector<std::string>& channels) {
  if (new_degree > sh_degree) {
    const std::size_t before = coefficients(sh_degree), after = coefficients(new_degree);
    std::vector<float> sh(after * slots);
    for (std::size_t i = 0; i < splats.size(); ++i) {
      std::copy_n(&splats.sh[before * i], before, &sh[after * i]);
    }
    splats.sh = std::move(sh);
    sh_degree = new_degree;
  }
  splats.positions.resize(3 * slots);
  splats.orientations.resize(4 * slots);
  splats.scales.resize(3 * slots);
  splats.sh.resize(coefficients(sh_degree) * slots);
  splats.opacities.resize(slots);
  while (splats.channels.size() < channels.size()) {
    splats.channels.emplace_back(
        channels[splats.channels.size()],
        std::vector<float>(slots, std::numeric_limits<float>::quiet_NaN()));
  }
}

// Harmonics of another degree: bands cut off, or zero bands added.
void copyHarmonics(const float* from, int from_degree, float* to, int to_degree) {
  const std::size_t have = coefficients(std::min(from_degree, to_degree));
  std::copy_n(from, have, to);
  std::fill_n(to + have, coefficients(to_degree) - have, 0.0f);
}

SplatArrays<const float> arraysOf(const Splats& splats, int sh_degree) {
  return {splats.size(),           sh_degree,
          splats.positions.data(), splats.orientations.data(),
          splats.scales.data(),    splats.opacities.data(),
          splats.sh.data()};
}

}  // namespace

// Of batches to send: those that aren't, because sending fails, are lost to all.
class PublishedMap::Numbering {
 public:
  Numbering(std::uint64_t& revision, std::size_t batches)
      : revision_(revision), last_(revision + batches) {}
  Numbering(const Numbering&) = delete;
  Numbering& operator=(const Numbering&) = delete;
  ~Numbering() { revision_ = last_; }

 private:
  std::uint64_t& revision_;
  const std::uint64_t last_;
};

PublishedMap::PublishedMap(MapOptions options, Wire wire)
    : options_(checked(std::move(options))), wire_(std::move(wire)), map_id_(randomId()) {}

std::uint64_t PublishedMap::revision() const {
  const std::lock_guard lock(mutex_);
  return revision_;
}

std::size_t PublishedMap::size() const {
  const std::lock_guard lock(mutex_);
  return map_.used;
}

std::vector<PublishedMap::Group> PublishedMap::groups() const {
  const std::lock_guard lock(mutex_);
  std::vector<Group> groups;
  for (Part& part : usedOf(allPages())) {
    Group& group = groups.emplace_back();
    group.number = part.group;
    group.splats = gathered(part, map_.channels);
    group.slots = std::move(part.slots);
  }
  return groups;
}

PublishedMap::Poses PublishedMap::poses() const {
  const std::lock_guard lock(mutex_);
  return placedAfter(0);
}

// --- Edits ---------------------------------------------------------------------------------------

void PublishedMap::replace(const Splats& splats, std::optional<std::uint32_t> expected_slots,
                           const Stamp& stamp) {
  const int sh_degree = withoutEmptyBands(splats, splats.check());
  if (splats.size() > Batch::MAX_SLOTS) {
    throw std::invalid_argument(std::to_string(splats.size()) + " splats: a map has " +
                                std::to_string(Batch::MAX_SLOTS) + " slots");
  }
  checkNumber("expected_slots", expected_slots.value_or(0), Batch::MAX_SLOTS);
  joined({}, namesOf(splats));
  const std::lock_guard lock(mutex_);
  Content before = std::exchange(map_, Content());
  try {
    warnOf(write(neighbours(0, splats.size()), splats, sh_degree, 0, 0));
    map_.expected_slots = expected_slots.value_or(static_cast<std::uint32_t>(splats.size()));
    sendMap(stamp);
  } catch (...) {
    map_ = std::move(before);
    begun_ = ++revision_;  // that nobody has
    try {                  // to whom a part of the other has come; where that fails, it is pulled
      sendMap(stamp);
    } catch (const std::exception&) {
    }
    throw;
  }
}

void PublishedMap::repeat() {
  const std::lock_guard lock(mutex_);
  sendMap(std::nullopt);
}

void PublishedMap::expect(std::uint32_t slots) {
  checkNumber("expected_slots", slots, Batch::MAX_SLOTS);
  const std::lock_guard lock(mutex_);
  map_.expected_slots = slots;
}

void PublishedMap::upsert(const Slots& slots, const Splats& splats, std::uint32_t group,
                          const Stamp& stamp) {
  const int sh_degree = withoutEmptyBands(splats, splats.check());
  checkSlots(slots);
  checkGroup(group);
  if (slots.size() != splats.size()) {
    throw std::invalid_argument("slots: " + std::to_string(splats.size()) + " splats for " +
                                std::to_string(slots.size()) + " slots");
  }
  const std::vector<std::string> channels = namesOf(splats);
  const std::lock_guard lock(mutex_);
  const std::vector<Part> parts =
      cut({group, slots}, std::max(sh_degree, map_.sh_degree), channels.size());
  warnOf(write(slots, splats, sh_degree, group, revision_ + parts.size()));
  const Numbering numbering(revision_, parts.size());
  for (const Part& part : parts) {
    send(writing(revision_ > 0 ? Batch::UPSERT : Batch::REPLACE, part, channels, stamp));
  }
}

void PublishedMap::upsert(std::uint32_t first_slot, const Splats& splats, std::uint32_t group,
                          const Stamp& stamp) {
  upsert(neighbours(first_slot, splats.size()), splats, group, stamp);
}

void PublishedMap::erase(const Slots& slots, const Stamp& stamp) {
  checkSlots(slots);
  const std::lock_guard lock(mutex_);
  for (const std::uint32_t slot : slots) {
    const auto found = map_.pages.find(slot / kPageSlots);
    if (found != map_.pages.end()) empty(found->second, slot % kPageSlots);
  }
  sendEdit(deletion(slots, stamp));
}

void PublishedMap::erase(std::uint32_t first_slot, std::uint32_t count, const Stamp& stamp) {
  const std::uint64_t end = checkedEnd(first_slot, count);
  const std::lock_guard lock(mutex_);
  const auto pages_end = map_.pages.lower_bound((end + kPageSlots - 1) / kPageSlots);
  for (auto at = map_.pages.lower_bound(first_slot / kPageSlots); at != pages_end; ++at) {
    for (std::uint32_t i = 0; i < kPageSlots; ++i) {
      const std::uint32_t slot = kPageSlots * at->first + i;
      if (slot >= first_slot && slot < end) empty(at->second, i);
    }
  }
  auto erased = batch(Batch::DELETE, stamp);
  if (count > 0) erased->first_slot = first_slot;
  erased->count = count;
  sendEdit(std::move(erased));
}

void PublishedMap::move(const Poses& poses, const Stamp& stamp) {
  Poses placed;
  for (const auto& [group, pose] : poses) {
    checkGroup(group);
    placed.emplace(group, checked(pose, group));
  }
  if (placed.empty()) return;
  const std::lock_guard lock(mutex_);
  for (const auto& [group, pose] : placed) {
    Frame& frame = map_.groups[group];
    frame.pose = pose;
    frame.placed = editRevision();
  }
  sendEdit(placement(placed, stamp));
}

// Puts the i-th splat into the i-th slot; returns how many mean nothing and are left out. revision:
// of the last batch that tells of it.
std::size_t PublishedMap::write(const Slots& slots, const Splats& splats, int sh_degree,
                                std::uint32_t group, std::uint64_t revision) {
  if (slots.empty()) return 0;
  if (!map_.pages.empty() && splats.antialiased != map_.antialiased) {
    throw std::invalid_argument(
        "antialiased: can't mix antialiased splats with others, they are drawn differently");
  }
  std::vector<std::uint32_t> touched;
  for (const std::uint32_t slot : slots) {
    if (touched.empty() || touched.back() != slot / kPageSlots)
      touched.push_back(slot / kPageSlots);
  }
  std::sort(touched.begin(), touched.end());
  touched.erase(std::unique(touched.begin(), touched.end()), touched.end());
  for (const std::uint32_t number : touched) {
    const auto found = map_.pages.find(number);
    if (found == map_.pages.end() || found->second.group == group || found->second.used.none()) {
      continue;
    }
    throw std::invalid_argument("slots " + std::to_string(number * kPageSlots) + " to " +
                                std::to_string(number * kPageSlots + kPageSlots - 1) +
                                " hold splats of group " + std::to_string(found->second.group) +
                                ", this batch is of group " + std::to_string(group) +
                                ": delete them first");
  }
  std::vector<std::string> channels = joined(map_.channels, namesOf(splats));
  std::vector<std::pair<const std::vector<float>*, std::size_t>> given;  // and where they go
  for (const auto& [name, values] : splats.channels) {
    const auto place = std::find(channels.begin(), channels.end(), name);
    given.emplace_back(&values, static_cast<std::size_t>(place - channels.begin()));
  }
  const bool begins = map_.pages.empty();
  // Memory may run out up to here: an empty page does no harm.
  for (const std::uint32_t number : touched) {
    const auto [found, is_new] = map_.pages.try_emplace(number);
    Page& page = found->second;
    if (is_new) page.group = group;
    makeRoom(page.splats, kPageSlots, page.sh_degree, sh_degree, channels);
  }
  Frame& frame = map_.groups[group];

  map_.channels = std::move(channels);
  map_.sh_degree = std::max(map_.sh_degree, sh_degree);
  if (begins) map_.antialiased = splats.antialiased;
  if (!frame.origin) frame.origin = splats.origin;
  for (const std::uint32_t number : touched) {
    Page& page = map_.pages[number];
    if (page.group != group) page.regrouped = revision;
    page.group = group;
    page.written = revision;
  }
  const int own_degree = splats.check();
  const SplatArrays<const float> arrays = arraysOf(splats, own_degree);
  std::size_t left_out = 0;
  std::uint32_t number = Batch::MAX_SLOTS;
  Page* page = nullptr;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (number != slots[i] / kPageSlots) page = &map_.pages[number = slots[i] / kPageSlots];
    const std::size_t at = slots[i] % kPageSlots;
    Splats& into = page->splats;
    float* const position = &into.positions[3 * at];
    for (int k = 0; k < 3; ++k) {
      const double shift = splats.origin[k] - (*frame.origin)[k];
      position[k] = shift == 0 ? splats.positions[3 * i + k]
                               : static_cast<float>(splats.positions[3 * i + k] + shift);
    }
    std::copy_n(&splats.orientations[4 * i], 4, &into.orientations[4 * at]);
    std::copy_n(&splats.scales[3 * i], 3, &into.scales[3 * at]);
    into.opacities[at] = splats.opacities[i];
    copyHarmonics(&splats.sh[arrays.shStride() * i], own_degree,
                  &into.sh[coefficients(page->sh_degree) * at], page->sh_degree);
    for (auto& [name, values] : into.channels) values[at] = std::numeric_limits<float>::quiet_NaN();
    for (const auto& [values, place] : given) into.channels[place].second[at] = (*values)[i];
    const bool usable = isUsable(arrays, i, position);
    left_out += !usable;
    map_.used += usable;
    map_.used -= page->used[at];
    page->used[at] = usable;
    page->changed[at] = revision;
  }
  return left_out;
}

void PublishedMap::empty(Page& page, std::uint32_t at) {
  map_.used -= page.used[at];
  page.used[at] = false;
  page.written = page.changed[at] = editRevision();
}

void PublishedMap::warnOf(std::size_t left_out) {
  if (left_out == 0) return;
  wire_.warn(std::to_string(left_out) +
             " splats are left out: a value is not finite, a scale negative or a quaternion zero");
}

// --- Sending -------------------------------------------------------------------------------------

void PublishedMap::sendMap(const Stamp& stamp) {
  std::vector<Part> parts;
  for (Part& group : usedOf(allPages())) {
    for (Part& part : cut(std::move(group), map_.sh_degree, map_.channels.size())) {
      parts.push_back(std::move(part));
    }
  }
  const Poses poses = placedAfter(0);
  const std::size_t before = poses.empty() ? 0 : 2;
  begun_ = revision_ + 1;
  for (auto& [number, page] : map_.pages) {
    page.written = page.regrouped = 0;
    page.changed.fill(0);
  }
  for (std::size_t i = 0; i < parts.size(); ++i) {
    std::uint32_t number = Batch::MAX_SLOTS;
    Page* page = nullptr;
    for (const std::uint32_t slot : parts[i].slots) {
      if (number != slot / kPageSlots) page = &map_.pages[number = slot / kPageSlots];
      page->written = page->changed[slot % kPageSlots] = begun_ + before + i;
    }
  }
  for (const auto& [group, pose] : poses) map_.groups[group].placed = begun_ + 1;
  const Numbering numbering(revision_, before + parts.size());
  if (!poses.empty()) {  // before any splat, so that none is seen elsewhere
    send(beginning(stamp));
    send(placement(poses, stamp));
  }
  for (const Part& part : parts) {
    const bool begins = poses.empty() && &part == &parts.front();
    send(writing(begins ? Batch::REPLACE : Batch::UPSERT, part, map_.channels, stamp));
  }
}

// Of an edit without splats. The first follows an empty REPLACE: see sendEdit.
std::uint64_t PublishedMap::editRevision() const { return revision_ > 0 ? revision_ + 1 : 2; }

void PublishedMap::sendEdit(std::unique_ptr<Batch> batch) {
  // Each map begins with a REPLACE: where a bag loops, it empties that of the round before.
  const bool begins = revision_ == 0;
  const Numbering numbering(revision_, begins ? 2 : 1);
  if (begins) send(beginning(batch->header.stamp));
  send(std::move(batch));
}

void PublishedMap::send(std::unique_ptr<Batch> batch) {
  batch->revision = ++revision_;
  wire_.send(std::move(batch));
}

std::vector<std::uint32_t> PublishedMap::allPages() const {
  std::vector<std::uint32_t> pages;
  for (const auto& [number, page] : map_.pages) pages.push_back(number);
  return pages;
}

// The slots in use of some pages that were written since a revision, by group. There is always a
// first group, empty where there are no splats.
std::vector<PublishedMap::Part> PublishedMap::usedOf(const std::vector<std::uint32_t>& pages,
                                                     std::uint64_t since) const {
  std::map<std::uint32_t, Slots> by_group;
  for (const std::uint32_t number : pages) {
    const Page& page = map_.pages.at(number);
    Slots slots;
    for (std::uint32_t i = 0; i < kPageSlots; ++i) {
      if (page.used[i] && page.changed[i] >= since) slots.push_back(number * kPageSlots + i);
    }
    if (slots.empty()) continue;
    Slots& group = by_group[page.group];
    group.insert(group.end(), slots.begin(), slots.end());
  }
  std::vector<Part> parts;
  for (auto& [group, slots] : by_group) parts.push_back({group, std::move(slots)});
  if (parts.empty()) parts.emplace_back();
  return parts;
}

// Into parts whose arrays take chunk_bytes at most, but one splat at least. There is always a first
// part, empty where there are no splats.
std::vector<PublishedMap::Part> PublishedMap::cut(Part whole, int sh_degree,
                                                  std::size_t channels) const {
  const std::size_t step =
      std::max<std::size_t>(1, options_.chunk_bytes / splatBytes(sh_degree, channels));
  if (whole.slots.size() <= step) return {std::move(whole)};
  std::vector<Part> parts;
  for (std::size_t first = 0; first < whole.slots.size(); first += step) {
    const auto begin = whole.slots.begin() + static_cast<std::ptrdiff_t>(first);
    const std::size_t count = std::min(step, whole.slots.size() - first);
    parts.push_back({whole.group, Slots(begin, begin + static_cast<std::ptrdiff_t>(count))});
  }
  return parts;
}

// Of memory, and of a message.
std::size_t PublishedMap::splatBytes(int sh_degree, std::size_t channels) {
  return sizeof(float) * (3 + 4 + 3 + 1 + coefficients(sh_degree) + channels);
}

// What is in slots, with these channels of the map's.
Splats PublishedMap::gathered(const Part& part, const std::vector<std::string>& channels) const {
  Splats splats;
  int sh_degree = 0;
  makeRoom(splats, part.slots.size(), sh_degree, map_.sh_degree, channels);
  splats.antialiased = map_.antialiased;
  const auto frame = map_.groups.find(part.group);
  if (frame != map_.groups.end() && frame->second.origin) splats.origin = *frame->second.origin;
  std::vector<std::size_t> places;
  for (const std::string& name : channels) {
    const auto place = std::find(map_.channels.begin(), map_.channels.end(), name);
    places.push_back(static_cast<std::size_t>(place - map_.channels.begin()));
  }
  std::uint32_t number = Batch::MAX_SLOTS;
  const Page* page = nullptr;
  for (std::size_t i = 0; i < part.slots.size(); ++i) {
    if (number != part.slots[i] / kPageSlots) {
      page = &map_.pages.at(number = part.slots[i] / kPageSlots);
    }
    const std::size_t at = part.slots[i] % kPageSlots;
    const Splats& from = page->splats;
    std::copy_n(&from.positions[3 * at], 3, &splats.positions[3 * i]);
    std::copy_n(&from.orientations[4 * at], 4, &splats.orientations[4 * i]);
    std::copy_n(&from.scales[3 * at], 3, &splats.scales[3 * i]);
    splats.opacities[i] = from.opacities[at];
    copyHarmonics(&from.sh[coefficients(page->sh_degree) * at], page->sh_degree,
                  &splats.sh[coefficients(sh_degree) * i], sh_degree);
    for (std::size_t k = 0; k < places.size(); ++k) {
      if (places[k] < from.channels.size()) {
        splats.channels[k].second[i] = from.channels[places[k]].second[at];
      }
    }
  }
  return splats;
}

// --- Batches, of the revision that the map has now -----------------------------------------------

std::unique_ptr<Batch> PublishedMap::batch(std::uint8_t operation, const Stamp& stamp) const {
  auto batch = std::make_unique<Batch>();
  batch->header.frame_id = options_.frame_id;
  batch->header.stamp = stamp ? *stamp : wire_.now();
  batch->map_id = map_id_;
  batch->revision = revision_;
  batch->operation = operation;
  batch->expected_slots = map_.expected_slots;
  return batch;
}

std::unique_ptr<Batch> PublishedMap::beginning(const Stamp& stamp) const {
  auto beginning = batch(Batch::REPLACE, stamp);
  beginning->sh_degree = static_cast<std::uint8_t>(map_.sh_degree);
  beginning->antialiased = map_.antialiased;
  return beginning;
}

std::unique_ptr<Batch> PublishedMap::writing(std::uint8_t operation, const Part& part,
                                             const std::vector<std::string>& channels,
                                             const Stamp& stamp) const {
  auto writing = batch(operation, stamp);
  name(part.slots, *writing);
  Splats splats = gathered(part, channels);
  writing->group = part.group;
  writing->sh_degree = static_cast<std::uint8_t>(map_.sh_degree);
  writing->antialiased = splats.antialiased;
  writing->origin.x = splats.origin[0];
  writing->origin.y = splats.origin[1];
  writing->origin.z = splats.origin[2];
  writing->channel_names = channels;
  for (const auto& [name, values] : splats.channels) {
    writing->channels.insert(writing->channels.end(), values.begin(), values.end());
  }
  if (options_.compression != kNone) {
    const SplatArrays<const float> arrays = arraysOf(splats, map_.sh_degree);
    std::vector<bool> usable(splats.size());
    for (std::size_t i = 0; i < usable.size(); ++i) {
      usable[i] = isUsable(arrays, i, &splats.positions[3 * i]);
    }
    if (payload::suits(arrays, usable)) {
      writing->format = payload::kFormat;
      writing->payload.resize(payload::size(arrays.count, arrays.sh_degree));
      payload::encode(arrays, usable, writing->payload.data());
      return writing;
    }
  }
  writing->positions = std::move(splats.positions);
  writing->orientations = std::move(splats.orientations);
  writing->scales = std::move(splats.scales);
  writing->opacities = std::move(splats.opacities);
  writing->sh = std::move(splats.sh);
  return writing;
}

std::unique_ptr<Batch> PublishedMap::deletion(const Slots& slots, const Stamp& stamp) const {
  auto deletion = batch(Batch::DELETE, stamp);
  name(slots, *deletion);
  return deletion;
}

std::unique_ptr<Batch> PublishedMap::placement(const Poses& poses, const Stamp& stamp) const {
  auto placement = batch(Batch::MOVE, stamp);
  for (const auto& [group, pose] : poses) {
    placement->groups.push_back(group);
    placement->poses.push_back(pose);
  }
  return placement;
}

// The slots that a batch touches: neighbours by the first of them.
void PublishedMap::name(const Slots& slots, Batch& batch) {
  batch.count = static_cast<std::uint32_t>(slots.size());
  if (slots.empty()) return;
  const auto gap =
      std::adjacent_find(slots.begin(), slots.end(), [](auto a, auto b) { return a + 1 != b; });
  if (gap == slots.end()) {
    batch.first_slot = slots.front();
  } else {
    batch.slots = slots;
  }
}

// --- Who lacks a part of the map
// ------------------------------------------------------------------

PublishedMap::Poses PublishedMap::placedAfter(std::uint64_t revision) const {
  Poses poses;
  for (const auto& [group, frame] : map_.groups) {
    if (frame.pose && frame.placed > revision) poses.emplace(group, *frame.pose);
  }
  return poses;
}

PublishedMap::PullMap::Response PublishedMap::pull(const PullMap::Request& request) const {
  PullMap::Response response;
  const std::lock_guard lock(mutex_);
  const bool meant = request.map_id.empty() || request.map_id == map_id_;
  if (!meant || revision_ == 0) return response;
  std::uint64_t after = request.after_revision;
  std::uint32_t block = request.first_block;
  if (after < begun_ || after > revision_) {
    // Who goes on with a map that was replaced meanwhile gets the new one in the next round.
    if (after > 0) block = 0;
    after = 0;
  }
  const auto answer = [&](std::unique_ptr<Batch> batch) {
    if (batch->expected_slots == 0) batch->expected_slots = static_cast<std::uint32_t>(map_.used);
    response.batches.push_back(std::move(*batch));
  };
  if (block == 0) {
    if (after == 0) answer(beginning(std::nullopt));
    const Poses placed = placedAfter(after);
    if (!placed.empty()) answer(placement(placed, std::nullopt));
  }
  const std::size_t splat_bytes = splatBytes(map_.sh_degree, map_.channels.size());
  const std::size_t most_bytes = std::min(options_.chunk_bytes, kAnswerBytes);
  std::vector<std::uint32_t> pages;
  Slots emptied;
  std::size_t bytes = 0;
  for (auto at = map_.pages.lower_bound(block); at != map_.pages.end(); ++at) {
    const auto& [number, page] = *at;
    if (page.written <= after) continue;
    Slots to_empty;
    for (std::uint32_t i = 0; i < kPageSlots; ++i) {
      const bool changed = page.changed[i] > after;
      if (changed && page.used[i]) bytes += splat_bytes;
      if (after > 0 && (page.regrouped > after || (changed && !page.used[i]))) {
        to_empty.push_back(number * kPageSlots + i);
      }
    }
    bytes += sizeof(to_empty[0]) * to_empty.size();
    if (!pages.empty() && bytes > most_bytes) {
      response.next_block = number;
      break;
    }
    pages.push_back(number);
    emptied.insert(emptied.end(), to_empty.begin(), to_empty.end());
  }
  if (!emptied.empty()) answer(deletion(emptied, std::nullopt));
  for (const Part& part : usedOf(pages, after + 1)) {
    if (!part.slots.empty() || response.batches.empty()) {
      answer(writing(Batch::UPSERT, part, map_.channels, std::nullopt));
    }
  }
  return response;
}

}  // namespace rosplat
