// How it works. A receiver's books of a map, without its splats. apply() turns a batch into an
// edit, which whoever draws takes later (arrivals.hpp):
// 1. check: what contradicts itself is refused, by its field's name, before anything changes.
// 2. stateAfter: the revision, what was missed, and whether the map begins anew.
// 3. layOutSplats: splats become packed slots, in float32 relative to their group's origin in
//    float64. Single splats without meaning are dropped.
// 4. The books of slots in use, of each block's group, of poses and of a sample are changed at
//    once, after `on_edit` has the edit: if memory is lacking, nothing has changed.

#include "rosplat_core/map/gaussian_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>
#include <string>

#include "rosplat_core/slots/packed_rows.hpp"
#include "rosplat_core/slots/payload_format.hpp"
#include "rosplat_core/slots/splats.hpp"
#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

namespace {

void checkLength(const char* field, std::size_t size, std::size_t expected) {
  if (size != expected) {
    throw BatchError(std::string(field) + " holds " + std::to_string(size) + " values, not the " +
                     std::to_string(expected) + " that count and sh_degree ask for");
  }
}

bool writes(const GaussianBatch& batch) {
  return batch.operation == GaussianBatch::REPLACE || batch.operation == GaussianBatch::UPSERT;
}

void checkGroup(const char* field, std::uint32_t group) {
  if (group >= kMostGroups) {
    throw BatchError(std::string(field) + " names group " + std::to_string(group) +
                     ", beyond the " + std::to_string(kMostGroups) + " that a map may have");
  }
}

// The moves of a MOVE, with quaternions of unit length.
std::vector<GroupMove> movesOf(const GaussianBatch& batch) {
  if (batch.count != 0) throw BatchError("count is " + std::to_string(batch.count) + " in a MOVE");
  if (batch.poses.size() != batch.groups.size) {
    throw BatchError("poses holds " + std::to_string(batch.poses.size()) + " values for " +
                     std::to_string(batch.groups.size) + " groups");
  }
  std::vector<GroupMove> moves(batch.groups.size);
  std::vector<bool> named(kMostGroups, false);
  for (std::size_t i = 0; i < moves.size(); ++i) {
    auto& [group, pose] = moves[i];
    group = batch.groups[i];
    pose = batch.poses[i];
    checkGroup("groups", group);
    if (named[group]) throw BatchError("groups names group " + std::to_string(group) + " twice");
    named[group] = true;
    const auto of = [group] { return "poses holds one of group " + std::to_string(group); };
    for (const double x : pose.position) {
      if (!std::isfinite(x)) throw BatchError(of() + " that is not finite");
    }
    double largest = 0, norm = 0;
    for (const double x : pose.orientation) {
      if (!std::isfinite(x)) throw BatchError(of() + " that is not finite");
      largest = std::max(largest, std::fabs(x));
    }
    if (largest == 0) throw BatchError(of() + " whose quaternion is zero");
    for (double& x : pose.orientation) x /= largest, norm += x * x;
    for (double& x : pose.orientation) x /= std::sqrt(norm);
  }
  return moves;
}

// Returns what a function returns. An argument that it calls invalid is a batch's.
template <typename Function>
auto ofBatch(const Function& function) {
  try {
    return function();
  } catch (const std::invalid_argument& error) {
    throw BatchError(error.what());
  }
}

PayloadFormat formatOf(const GaussianBatch& batch) {
  return ofBatch([&] { return payloadFormat(batch.format); });
}

void check(const GaussianBatch& batch) {
  if (batch.revision == 0) throw BatchError("revision is 0, they count from 1");
  if (batch.operation > GaussianBatch::MOVE) {
    throw BatchError("operation " + std::to_string(batch.operation) + " is unknown");
  }
  const bool packed = !batch.format.empty();
  const PayloadFormat format = packed ? formatOf(batch) : PayloadFormat{};
  if (batch.sh_degree > kMaxShDegree) {
    throw BatchError("sh_degree " + std::to_string(batch.sh_degree) + " is beyond 3");
  }
  ofBatch([&] { return modelOf(batch.model); });
  for (double v : batch.origin) {
    if (!std::isfinite(v)) throw BatchError("origin is not finite");
  }
  const std::size_t n = batch.count;
  if (!batch.slots.empty()) {
    checkLength("slots", batch.slots.size, n);
    for (std::size_t i = 0; i < n; ++i) {
      if (batch.slots[i] >= kMaxSlots) {
        throw BatchError("slots names slot " + std::to_string(batch.slots[i]) + ", beyond the " +
                         std::to_string(kMaxSlots) + " that a map may have");
      }
    }
  } else if (batch.first_slot > kMaxSlots || n > kMaxSlots - batch.first_slot) {
    throw BatchError("first_slot + count is beyond the " + std::to_string(kMaxSlots) +
                     " slots that a map may have");
  }
  checkGroup("group", batch.group);
  if (batch.operation != GaussianBatch::MOVE && !(batch.groups.empty() && batch.poses.empty())) {
    throw BatchError("groups and poses are a MOVE's alone");
  }
  const bool values = writes(batch);
  if (!values && packed) throw BatchError("format is for batches with splats");
  checkLength("payload", batch.payload.size, packed ? format.size(n, batch.sh_degree) : 0);
  const std::size_t splats = values && !packed ? n : 0;  // in arrays
  checkLength("positions", batch.positions.size, 3 * splats);
  checkLength("orientations", batch.orientations.size, 4 * splats);
  checkLength("scales", batch.scales.size, 3 * splats);
  checkLength("opacities", batch.opacities.size, splats);
  checkLength("sh", batch.sh.size, harmonicsOf(batch.sh_degree) * splats);
  joined({}, batch.channel_names);
  if (!values && !batch.channel_names.empty()) {
    throw BatchError("channel_names are for batches with splats");
  }
  if (batch.channels.size != n * batch.channel_names.size()) {
    throw BatchError("channels holds " + std::to_string(batch.channels.size) +
                     " values, not count for each of the " +
                     std::to_string(batch.channel_names.size()) + " channel_names");
  }
}

SlotRuns runsOf(const GaussianBatch& batch) {
  SlotRuns runs;
  if (batch.slots.empty()) {
    if (batch.count > 0) runs.emplace_back(batch.first_slot, batch.count);
    return runs;
  }
  for (std::size_t i = 0; i < batch.count; ++i) {
    const std::uint32_t slot = batch.slots[i];
    if (!runs.empty() && runs.back().first + runs.back().second == slot) {
      ++runs.back().second;
    } else {
      runs.emplace_back(slot, 1);
    }
  }
  return runs;
}

// Makes room for the splats of a batch, with bands up to edit.sh_degree.
void makeRoom(const GaussianBatch& batch, GaussianEdit& edit) {
  const std::size_t n = batch.count;
  edit.slots.assign(kSlotWords * n, 0u);
  edit.extents.assign(n, -1.0f);
  for (int band = 1; band <= edit.sh_degree; ++band) {
    edit.bands[band].resize(kBandWords[band] * n);
  }
}

constexpr int kThirdScaleWord = 4;

// Lays out the packed rows of a batch, relative to an origin. flat: without third scales. Returns
// which of them are valid.
std::vector<bool> layOutRows(const GaussianBatch& batch, const std::array<double, 3>& origin,
                             bool flat, GaussianEdit& edit) {
  const std::size_t n = batch.count, bytes = packed_rows::size(1, batch.sh_degree);
  std::vector<bool> kept(n, false);
  std::array<std::uint32_t, rowWords(kMaxShDegree)> row{};
  const auto bands = bandsOf<const std::uint32_t>(row.data());
  const bool rebase = batch.origin != origin;
  for (std::size_t i = 0; i < n; ++i) {
    std::memcpy(row.data(), batch.payload.data + bytes * i, bytes);
    row[kChangeWord] &= 0xffffu;                // the upper half is the receiver's own
    if (flat) row[kThirdScaleWord] &= 0xffffu;  // its upper half
    for (int k = 0; rebase && k < 3; ++k) {
      float x;
      std::memcpy(&x, &row[k], sizeof(x));
      x = static_cast<float>(double(x) + batch.origin[k] - origin[k]);
      std::memcpy(&row[k], &x, sizeof(x));
    }
    kept[i] = packed_rows::isUsable(row.data());
    if (!kept[i]) continue;
    std::copy_n(row.data(), kSlotWords, &edit.slots[kSlotWords * i]);
    for (int band = 1; band <= edit.sh_degree; ++band) {
      std::copy_n(bands[band], kBandWords[band], &edit.bands[band][kBandWords[band] * i]);
    }
    edit.extents[i] = extentOf(slotOpacity(row.data()), largestScale(row.data()));
  }
  return kept;
}

// The arrays of a batch; memory: for those of its payload, if it has one.
SplatArrays<const float> arraysOf(const GaussianBatch& batch, Splats& memory) {
  if (batch.format.empty()) {
    return {batch.count,       batch.sh_degree,      batch.positions.data, batch.orientations.data,
            batch.scales.data, batch.opacities.data, batch.sh.data};
  }
  const SplatArrays<float> arrays = memory.resize(batch.count, batch.sh_degree);
  ofBatch([&] { return formatOf(batch).decode(batch.payload.data, arrays); });
  return memory.view().arrays;
}

// Does the same with the arrays of a batch.
std::vector<bool> layOut(const GaussianBatch& batch, const std::array<double, 3>& origin, bool flat,
                         GaussianEdit& edit) {
  const std::size_t n = batch.count;
  std::vector<bool> kept(n, false);
  Splats memory;
  const SplatArrays<const float> splats = arraysOf(batch, memory);
  const bool rebase = batch.origin != origin;
  for (std::size_t i = 0; i < n; ++i) {
    Splat splat = splatAt(splats, i);
    for (int k = 0; rebase && k < 3; ++k) {
      splat.position[k] =
          static_cast<float>(double(splat.position[k]) + batch.origin[k] - origin[k]);
    }
    kept[i] = isUsable(splats, i, splat.position.data());
    if (!kept[i]) continue;
    if (flat) splat.scale[2] = 0;
    splat.opacity = std::clamp(splat.opacity, 0.0f, 1.0f);
    const float* const sh = splats.sh + splats.shStride() * i;
    std::array<std::uint32_t*, kMaxShDegree + 1> bands{};
    for (int band = 1; band <= edit.sh_degree; ++band) {
      bands[band] = &edit.bands[band][kBandWords[band] * i];
    }
    packSlot(splat, sh + 3, edit.sh_degree, &edit.slots[kSlotWords * i], bands);
    edit.extents[i] =
        extentOf(splat.opacity, *std::max_element(splat.scale.begin(), splat.scale.end()));
  }
  return kept;
}

// Lays out the values of a batch's channels in the order of the map's channels.
void layOutChannels(const GaussianBatch& batch, const std::vector<bool>& kept,
                    std::vector<Channel>& channels, GaussianEdit& edit) {
  const float* values = batch.channels.data;
  for (const std::string& name : batch.channel_names) {
    const std::size_t index = indexOf(channels, name);
    edit.channels[index].assign(values, values + batch.count);
    for (std::size_t i = 0; i < batch.count; ++i) {
      if (kept[i]) channels[index].widen(values[i]);
    }
    values += batch.count;
  }
}

// Changes which slots are in use, and takes that back at its end unless it is kept.
class SlotUse {
 public:
  // runs: of the slots that set() gets, one after the other. most: slots that empty() gets.
  SlotUse(SlotSet& used, const SlotRuns& runs, std::size_t most)
      : used_(used), runs_(runs), before_(countSlots(runs)) {
    emptied_.reserve(most);
  }
  SlotUse(const SlotUse&) = delete;
  SlotUse& operator=(const SlotUse&) = delete;
  ~SlotUse() {
    if (committed_) return;
    std::size_t i = before_.size();
    for (auto run = runs_.rbegin(); run != runs_.rend(); ++run) {
      for (std::uint32_t k = run->second; k > 0; --k) {
        if (--i < set_) used_.set(run->first + k - 1, before_[i]);
      }
    }
    for (const std::uint32_t slot : emptied_) used_.set(slot, true);
  }

  // Both return whether the slot was in use.
  bool set(std::uint32_t slot, bool in_use) {
    const bool before = used_.set(slot, in_use);
    before_[set_++] = before;
    return before;
  }
  bool empty(std::uint32_t slot) {
    const bool before = used_.set(slot, false);
    if (before) emptied_.push_back(slot);
    return before;
  }
  void commit() { committed_ = true; }

 private:
  SlotSet& used_;
  const SlotRuns& runs_;
  std::vector<bool> before_;
  std::size_t set_ = 0;
  std::vector<std::uint32_t> emptied_;
  bool committed_ = false;
};

}  // namespace

std::size_t SlotArrays::bytes() const {
  std::size_t words = 0;
  forEachArray([&words](std::size_t, const auto& array) { words += array.capacity(); }, *this);
  return words * sizeof(std::uint32_t);
}

std::shared_ptr<const GaussianEdit> GaussianMap::apply(const GaussianBatch& batch,
                                                       BatchReport& report, const OnEdit& on_edit) {
  const std::lock_guard one_by_one(locks_.applying);
  // A pulled batch that fails leaves no gap in the revisions.
  if (batch.arrival != Arrival::kHeard) ++lost_;
  check(batch);

  // Memory may run out at any line until `on_edit` returns; the map is then unchanged.
  auto edit = std::make_shared<GaussianEdit>();
  edit->clear = begins(batch);
  if (batch.operation == GaussianBatch::MOVE) edit->moves = movesOf(batch);
  MapState next = stateAfter(batch, report);
  edit->round = next.round;
  edit->revision = next.revision;

  Groups fresh_groups;
  Groups& groups = edit->clear ? fresh_groups : groups_;
  const bool places = writes(batch) && batch.count > 0;
  if (const std::size_t more = edit->moves.size() + (places ? 1 : 0); !groups.hasRoom(more)) {
    Groups larger = groups;
    larger.makeRoom(more);
    const std::lock_guard lock(locks_.exchanging);
    std::swap(groups, larger);
  }
  std::size_t group_index = 0;
  if (places) {
    const Group* const known = groups.find(batch.group);
    const bool has_origin = known && known->origin;
    edit->group = batch.group;
    edit->origin = has_origin ? *known->origin : batch.origin;
    next.groups += has_origin ? 0 : 1;
    group_index = known ? std::size_t(known - groups.all().data()) : groups.all().size();
  }

  SlotSet fresh;
  SlotSet& used = edit->clear ? fresh : used_;
  edit->runs = runsOf(batch);
  std::vector<bool> kept;
  std::vector<std::uint32_t> of_others;
  if (writes(batch)) {
    of_others = blocksOfOthers(used, edit->runs, batch);
    kept = layOutSplats(batch, next, *edit);
    report.dropped = static_cast<std::uint64_t>(std::count(kept.begin(), kept.end(), false));
    next.dropped += report.dropped;
    used.makeRoom(edit->runs);
    const std::size_t blocks = (next.capacity + SlotSet::kPage - 1) / SlotSet::kPage;
    if (block_groups_.size() < blocks) block_groups_.resize(blocks);
  } else {
    edit->runs = used.within(edit->runs);
    kept.resize(countSlots(edit->runs), false);
  }
  edit->capacity = next.capacity;

  MapSample sample = edit->clear ? MapSample() : sample_;
  SlotUse use(used, edit->runs, of_others.size() * SlotSet::kPage);
  for (const std::uint32_t block : of_others) {
    for (std::uint32_t slot = block; slot < block + SlotSet::kPage; ++slot) {
      if (!use.empty(slot)) continue;
      sample.drop(slot);
      --next.splats;
    }
  }
  std::size_t i = 0;
  forEachSlot(edit->runs, [&](std::uint32_t slot) {
    next.splats += int(kept[i]) - int(use.set(slot, kept[i]));
    if (kept[i]) {
      const std::uint32_t* const words = &edit->slots[kSlotWords * i];
      sample.set(slot, {edit->position(i), largestScale(words), slotOpacity(words),
                        static_cast<std::uint32_t>(group_index)});
    } else {
      sample.drop(slot);
    }
    ++i;
  });
  if (on_edit) on_edit(edit, next);

  use.commit();
  if (edit->clear) used_ = std::move(fresh);
  if (writes(batch)) {
    forEachPart(edit->runs, [&](std::uint32_t slot, std::uint32_t, std::size_t) {
      block_groups_[slot / SlotSet::kPage] = static_cast<std::uint16_t>(batch.group);
    });
  }
  const std::lock_guard lock(locks_.exchanging);
  state_ = std::move(next);
  sample_ = std::move(sample);
  if (edit->clear) groups_ = std::move(fresh_groups);
  for (const GroupMove& move : edit->moves) groups_.move(move);
  if (places) groups_.write(edit->group, edit->origin);
  lost_ = batch.arrival == Arrival::kPulled && !edit->clear ? lost_ - 1 : 0;
  return edit;
}

bool GaussianMap::begins(const GaussianBatch& batch) const {
  return batch.map_id != state_.id || batch.operation == GaussianBatch::REPLACE;
}

MapState GaussianMap::stateAfter(const GaussianBatch& batch, BatchReport& report) const {
  const bool heard = batch.arrival == Arrival::kHeard, new_map = batch.map_id != state_.id;
  const bool back = heard && !new_map && batch.revision <= state_.revision;
  MapState next;
  if (!begins(batch)) next = state_;
  // A REPLACE needs none of the batches before it. A map that is played again, but not from its
  // beginning, lacks all batches before.
  if (back) next.revision = next.missed = 0;
  if (heard && batch.operation != GaussianBatch::REPLACE) {
    report.missed = batch.revision - next.revision - 1;
  }
  if (batch.arrival == Arrival::kLast) next.missed = begins(batch) ? 0 : lost_ - 1;
  next.missed += report.missed;
  if (!heard) next.pulled = batch.arrival == Arrival::kPulled;
  next.id = batch.map_id;
  next.round = state_.round + (new_map || back ? 1 : 0);
  next.revision = batch.revision;
  next.begun = state_.begun + (begins(batch) ? 1 : 0);
  next.edits = state_.edits + 1;
  next.expected = batch.expected_slots;
  return next;
}

std::vector<bool> GaussianMap::layOutSplats(const GaussianBatch& batch, MapState& next,
                                            GaussianEdit& edit) const {
  if (batch.count > 0 && next.capacity == 0) next.model = Model(batch.model);
  const bool flat = next.model == Model::kDisc;
  edit.sh_degree = std::min<int>(batch.sh_degree, most_sh_degree_);
  makeRoom(batch, edit);
  std::vector<bool> kept;
  if (batch.format == packed_rows::kFormat) {
    kept = layOutRows(batch, edit.origin, flat, edit);
  } else {
    kept = layOut(batch, edit.origin, flat, edit);
  }
  if (batch.count > 0) {
    next.channels = joined(std::move(next.channels), batch.channel_names);
    layOutChannels(batch, kept, next.channels, edit);
  }
  next.sh_degree = std::max(next.sh_degree, edit.sh_degree);
  for (const auto& [first, count] : edit.runs) {
    next.capacity = std::max(next.capacity, first + count);
  }
  return kept;
}

std::vector<std::array<double, 3>> GaussianMap::samplePositions() const {
  return inspect([](const MapState&, const MapSample& sample, const Groups& groups) {
    std::vector<std::array<double, 3>> positions;
    for (const SampledSplat& splat : sample.splats()) {
      const auto& [x, y, z] = splat.position;
      positions.push_back(groups.all()[splat.group].inMap(std::array<double, 3>{x, y, z}));
    }
    return positions;
  });
}

std::vector<std::uint32_t> GaussianMap::blocksOfOthers(const SlotSet& used, const SlotRuns& runs,
                                                       const GaussianBatch& batch) const {
  std::vector<std::uint32_t> blocks;
  forEachPart(runs, [&](std::uint32_t slot, std::uint32_t, std::size_t) {
    const std::uint32_t block = slot / SlotSet::kPage;
    if (block < block_groups_.size() && block_groups_[block] != batch.group && used.any(block)) {
      blocks.push_back(block * SlotSet::kPage);
    }
  });
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
  if (batch.arrival == Arrival::kHeard && !blocks.empty()) {
    const std::uint32_t begin = blocks.front();
    throw BatchError("group is " + std::to_string(batch.group) + ", but slots " +
                     std::to_string(begin) + " to " + std::to_string(begin + SlotSet::kPage - 1) +
                     " hold splats of group " +
                     std::to_string(block_groups_[begin / SlotSet::kPage]) + ": delete them first");
  }
  return blocks;
}

GaussianEdit editOf(PackedRun run, ThreadTeam* team) {
  GaussianEdit edit;
  const std::size_t count = run.slots.size() / kSlotWords;
  edit.group = run.group.number;
  edit.origin = run.group.originOrZero();
  edit.runs = {{run.first_slot, static_cast<std::uint32_t>(count)}};
  edit.sh_degree = run.sh_degree;
  static_cast<SlotArrays&>(edit) = std::move(run);
  edit.extents.resize(count);
  constexpr std::size_t kPart = 4096;
  inParts(team, (count + kPart - 1) / kPart, [&](std::size_t part) {
    for (std::size_t i = kPart * part; i < std::min(count, kPart * (part + 1)); ++i) {
      std::uint32_t* const slot = &edit.slots[kSlotWords * i];
      slot[kChangeWord] &= 0xffffu;
      edit.extents[i] = extentOf(slotOpacity(slot), largestScale(slot));
    }
  });
  std::size_t used = count;  // one past the last slot in use
  while (used > 0 && (edit.slots[kSlotWords * (used - 1) + 3] & 0xffffu) == 0) --used;
  if (used > 0) edit.capacity = edit.runs[0].first + static_cast<std::uint32_t>(used);
  return edit;
}

GaussianEdit editOf(const Groups& groups) {
  GaussianEdit edit;
  std::transform(groups.all().begin(), groups.all().end(), std::back_inserter(edit.moves),
                 [](const Group& group) { return GroupMove{group.number, group.pose}; });
  return edit;
}

SplatValues valuesOf(std::uint32_t slot, const Group& group, const std::uint32_t* words,
                     int sh_degree,
                     const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands) {
  const Splat splat = unpackSlot(words);
  const auto& [x, y, z] = splat.position;
  SplatValues values;
  values.slot = slot;
  values.group = group.number;
  values.position = group.inMap(std::array<double, 3>{x, y, z});
  values.orientation = group.inMap(splat.orientation);
  values.scale = splat.scale;
  values.opacity = splat.opacity;
  values.sh.assign(splat.color.begin(), splat.color.end());
  const std::vector<float> rest = unpackHarmonics(words, sh_degree, bands);
  values.sh.insert(values.sh.end(), rest.begin(), rest.end());
  return values;
}

}  // namespace rosplat
