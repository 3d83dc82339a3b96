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

// Radius of the ellipsoid on which alpha falls to 1/255, -1 for a splat that never reaches that.
float extent(const float* scale, float opacity) {
  if (!(opacity >= 1.0f / 255.0f)) return -1.0f;
  const float sigmas = std::min(3.33f, std::sqrt(2.0f * std::log(255.0f * opacity)));
  return sigmas * std::max({scale[0], scale[1], scale[2]});
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

  auto edit = std::make_shared<GaussianEdit>();
  edit->clear = new_map || replace;
  edit->revision = batch.revision;
  // Memory may run out at any line until the last: the map is changed there.
  MapState next;
  std::vector<bool> used;
  MapSample sample;
  if (edit->clear) {
    next.origin = batch.origin;
    next.antialiased = batch.antialiased;
  } else {
    next = state_;
    used = used_;
    sample = sample_;
  }
  // A REPLACE makes whatever came before it unimportant. A map that is played once more, but not
  // from its beginning, lacks all before.
  if (back) next.revision = next.missed = 0;
  if (!replace) report.missed = batch.revision - next.revision - 1;
  next.id = batch.map_id;
  next.revision = batch.revision;
  next.expected = batch.expected_slots;

  const std::size_t n = batch.count;
  if (batch.slots.empty()) {
    if (n > 0) edit->runs.emplace_back(batch.first_slot, batch.count);
  } else {
    for (std::size_t i = 0; i < n; ++i) {
      if (!edit->runs.empty() &&
          edit->runs.back().first + edit->runs.back().second == batch.slots[i]) {
        ++edit->runs.back().second;
      } else {
        edit->runs.emplace_back(batch.slots[i], 1);
      }
    }
  }

  const bool values = batch.operation != GaussianBatch::DELETE;
  edit->slots.assign(kSlotWords * n, 0u);
  edit->positions.assign(3 * n, 0.0f);
  edit->extents.assign(n, -1.0f);
  std::vector<bool> kept(n, false);
  if (values) {
    edit->sh_degree = batch.sh_degree;
    next.sh_degree = std::max<int>(next.sh_degree, batch.sh_degree);
    for (int band = 1; band <= batch.sh_degree; ++band) {
      edit->bands[band].resize(kBandWords[band] * n);
    }
    const std::size_t coefficients = 3u * (batch.sh_degree + 1u) * (batch.sh_degree + 1u);
    const bool rebase = batch.origin != next.origin;
    for (std::size_t i = 0; i < n; ++i) {
      const float* q = &batch.orientations.data[4 * i];
      const float* scale = &batch.scales.data[3 * i];
      const float* sh = batch.sh.data + coefficients * i;
      const float norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
      float position[3];
      for (int k = 0; k < 3; ++k) {
        position[k] = rebase ? static_cast<float>(double(batch.positions[3 * i + k]) +
                                                  batch.origin[k] - next.origin[k])
                             : batch.positions[3 * i + k];
      }
      kept[i] = allFinite(position, 3) && allFinite(scale, 3) && std::isnormal(norm) &&
                scale[0] >= 0.0f && scale[1] >= 0.0f && scale[2] >= 0.0f &&
                std::isfinite(batch.opacities[i]) && allFinite(sh, coefficients);
      if (!kept[i]) {
        ++report.dropped;
        continue;
      }
      Splat splat;
      std::copy_n(position, 3, splat.position.begin());
      std::copy_n(q, 4, splat.orientation.begin());
      std::copy_n(scale, 3, splat.scale.begin());
      std::copy_n(sh, 3, splat.color.begin());
      splat.opacity = std::clamp(batch.opacities[i], 0.0f, 1.0f);
      std::array<std::uint32_t*, kMaxShDegree + 1> bands{};
      for (int band = 1; band <= batch.sh_degree; ++band) {
        bands[band] = &edit->bands[band][kBandWords[band] * i];
      }
      packSlot(splat, sh + 3, batch.sh_degree, &edit->slots[kSlotWords * i], bands);
      std::copy_n(position, 3, &edit->positions[3 * i]);
      edit->extents[i] = extent(scale, splat.opacity);
    }
  }

  std::size_t i = 0;
  for (const auto& [first, count] : edit->runs) {
    next.capacity = values ? std::max(next.capacity, first + count) : next.capacity;
    if (used.size() < next.capacity) used.resize(next.capacity);
    for (std::uint32_t slot = first; slot < first + count; ++slot, ++i) {
      if (slot >= used.size()) continue;  // a DELETE of slots never used
      next.splats += int(kept[i]) - int(used[slot]);
      used[slot] = kept[i];
      if (!kept[i]) {
        sample.drop(slot);
        continue;
      }
      const float* position = &edit->positions[3 * i];
      const float* scale = &batch.scales.data[3 * i];
      sample.keep(slot, {{position[0], position[1], position[2]},
                         std::max({scale[0], scale[1], scale[2]}),
                         batch.opacities[i]});
    }
  }
  edit->capacity = next.capacity;
  next.missed += report.missed;
  next.dropped += report.dropped;
  if (keep) keep(edit, next);
  state_ = std::move(next);
  used_ = std::move(used);
  sample_ = std::move(sample);
  return edit;
}

}  // namespace rosplat
