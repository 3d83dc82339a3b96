#include "map/gaussian_map.hpp"

#include <algorithm>
#include <cmath>
#include <string>

namespace rosplat {

namespace {

void checkLength(const char* field, std::size_t size, std::size_t expected) {
  if (size != expected) {
    throw BatchError(std::string(field) + " holds " + std::to_string(size) + " values, not the " +
                     std::to_string(expected) + " that count and sh_degree ask for");
  }
}

void check(const GaussianBatch& batch) {
  if (batch.revision == 0) throw BatchError("revision is 0, they count from 1");
  if (batch.operation > GaussianBatch::DELETE) {
    throw BatchError("operation " + std::to_string(batch.operation) + " is unknown");
  }
  if (batch.encoding != 0) {
    throw BatchError("encoding " + std::to_string(batch.encoding) + " is unknown");
  }
  if (batch.sh_degree > kMaxShDegree) {
    throw BatchError("sh_degree " + std::to_string(batch.sh_degree) + " is beyond 3");
  }
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
  const bool values = batch.operation != GaussianBatch::DELETE;
  const std::size_t coefficients = 3u * (batch.sh_degree + 1u) * (batch.sh_degree + 1u);
  checkLength("positions", batch.positions.size, values ? 3 * n : 0);
  checkLength("orientations", batch.orientations.size, values ? 4 * n : 0);
  checkLength("scales", batch.scales.size, values ? 3 * n : 0);
  checkLength("opacities", batch.opacities.size, values ? n : 0);
  checkLength("sh", batch.sh.size, values ? coefficients * n : 0);
}

bool allFinite(const float* values, std::size_t count) {
  // A sum of zero times each value is NaN as soon as one value is not finite; it vectorises.
  float sum = 0.0f;
  for (std::size_t i = 0; i < count; ++i) sum += 0.0f * values[i];
  return sum == 0.0f;
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

// Lays the splats of a batch out, relative to an origin; which of them mean something.
std::vector<bool> layOut(const GaussianBatch& batch, const std::array<double, 3>& origin,
                         GaussianEdit& edit) {
  const std::size_t n = batch.count;
  edit.sh_degree = batch.sh_degree;
  edit.slots.assign(kSlotWords * n, 0u);
  edit.positions.assign(3 * n, 0.0f);
  edit.extents.assign(n, -1.0f);
  for (int band = 1; band <= batch.sh_degree; ++band) {
    edit.bands[band].resize(kBandWords[band] * n);
  }
  std::vector<bool> kept(n, false);
  const std::size_t coefficients = 3u * (batch.sh_degree + 1u) * (batch.sh_degree + 1u);
  const bool rebase = batch.origin != origin;
  for (std::size_t i = 0; i < n; ++i) {
    const float* q = &batch.orientations.data[4 * i];
    const float* scale = &batch.scales.data[3 * i];
    const float* sh = batch.sh.data + coefficients * i;
    float position[3];
    for (int k = 0; k < 3; ++k) {
      position[k] =
          rebase
              ? static_cast<float>(double(batch.positions[3 * i + k]) + batch.origin[k] - origin[k])
              : batch.positions[3 * i + k];
    }
    const bool turned = q[0] != 0.0f || q[1] != 0.0f || q[2] != 0.0f || q[3] != 0.0f;
    kept[i] = allFinite(position, 3) && allFinite(scale, 3) && allFinite(q, 4) && turned &&
              scale[0] >= 0.0f && scale[1] >= 0.0f && scale[2] >= 0.0f &&
              std::isfinite(batch.opacities[i]) && allFinite(sh, coefficients);
    if (!kept[i]) continue;
    Splat splat;
    std::copy_n(position, 3, splat.position.begin());
    std::copy_n(q, 4, splat.orientation.begin());
    std::copy_n(scale, 3, splat.scale.begin());
    std::copy_n(sh, 3, splat.color.begin());
    splat.opacity = std::clamp(batch.opacities[i], 0.0f, 1.0f);
    std::array<std::uint32_t*, kMaxShDegree + 1> bands{};
    for (int band = 1; band <= batch.sh_degree; ++band) {
      bands[band] = &edit.bands[band][kBandWords[band] * i];
    }
    packSlot(splat, sh + 3, batch.sh_degree, &edit.slots[kSlotWords * i], bands);
    std::copy_n(position, 3, &edit.positions[3 * i]);
    edit.extents[i] = extentOf(splat);
  }
  return kept;
}

}  // namespace

std::shared_ptr<const GaussianEdit> GaussianMap::apply(const GaussianBatch& batch,
                                                       BatchReport& report, const Keep& keep) {
  check(batch);
  const bool new_map = batch.map_id != state_.id;
  const bool back = !new_map && batch.revision <= state_.revision;
  if (back && batch.snapshot && state_.missed == 0) {
    report.duplicate = true;
    return nullptr;
  }
  const bool replace = batch.operation == GaussianBatch::REPLACE;
  const bool values = batch.operation != GaussianBatch::DELETE;

  auto edit = std::make_shared<GaussianEdit>();
  edit->clear = new_map || replace;
  // Memory may run out at any line until `keep` is through: the map is as before then.
  MapState next;
  SlotSet fresh;
  SlotSet& used = edit->clear ? fresh : used_;
  if (!edit->clear) next = state_;
  // A REPLACE makes whatever came before it unimportant. A map that is played once more, but not
  // from its beginning, lacks all before.
  if (back) next.revision = next.missed = 0;
  if (!replace) report.missed = batch.revision - next.revision - 1;
  next.id = batch.map_id;
  next.round = state_.round + (new_map || back ? 1 : 0);
  next.revision = batch.revision;
  next.expected = batch.expected_slots;
  if (values && batch.count > 0 && next.capacity == 0) {
    next.origin = batch.origin;
    next.antialiased = batch.antialiased;
  }

  edit->runs = runsOf(batch);
  std::vector<bool> kept;
  if (values) {
    kept = layOut(batch, next.origin, *edit);
    report.dropped = static_cast<std::uint64_t>(std::count(kept.begin(), kept.end(), false));
    next.sh_degree = std::max<int>(next.sh_degree, batch.sh_degree);
    used.makeRoom(edit->runs);
    for (const auto& [first, count] : edit->runs) {
      next.capacity = std::max(next.capacity, first + count);
    }
  } else {
    edit->runs = used.within(edit->runs);
    kept.resize(countSlots(edit->runs), false);
  }
  edit->round = next.round;
  edit->revision = next.revision;
  edit->capacity = next.capacity;
  next.missed += report.missed;
  next.dropped += report.dropped;

  std::vector<bool> before(kept.size());
  std::size_t i = 0;
  forEachSlot(edit->runs, [&](std::uint32_t slot) {
    before[i] = used.set(slot, kept[i]);
    next.splats += int(kept[i]) - int(before[i]);
    ++i;
  });
  try {
    if (keep) keep(edit, next);
  } catch (...) {
    for (auto run = edit->runs.rbegin(); run != edit->runs.rend(); ++run) {
      for (std::uint32_t k = run->second; k > 0; --k) used.set(run->first + k - 1, before[--i]);
    }
    throw;
  }
  state_ = std::move(next);
  if (edit->clear) {
    used_ = std::move(fresh);
    sample_.clear();
  }
  i = 0;
  forEachSlot(edit->runs, [&](std::uint32_t slot) {
    if (kept[i]) {
      const float* position = &edit->positions[3 * i];
      const float* scale = &batch.scales.data[3 * i];
      sample_.keep(slot, {{position[0], position[1], position[2]},
                          std::max({scale[0], scale[1], scale[2]}),
                          batch.opacities[i]});
    } else {
      sample_.drop(slot);
    }
    ++i;
  });
  return edit;
}

GaussianEdit editOf(std::uint32_t first_slot, std::vector<std::uint32_t> slots,
                    std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands, int sh_degree) {
  GaussianEdit edit;
  const std::size_t count = slots.size() / kSlotWords;
  edit.runs = {{first_slot, static_cast<std::uint32_t>(count)}};
  edit.sh_degree = sh_degree;
  edit.slots = std::move(slots);
  edit.bands = std::move(bands);
  for (std::size_t i = 0; i < count; ++i) {
    edit.slots[kSlotWords * i + kChangeWord] &= 0xffffu;
    const Splat splat = unpackSlot(&edit.slots[kSlotWords * i]);
    if (splat.opacity > 0) edit.capacity = first_slot + static_cast<std::uint32_t>(i) + 1;
    edit.positions.insert(edit.positions.end(), splat.position.begin(), splat.position.end());
    edit.extents.push_back(extentOf(splat));
  }
  return edit;
}

}  // namespace rosplat
