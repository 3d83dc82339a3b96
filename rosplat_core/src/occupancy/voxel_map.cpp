#include "rosplat_core/occupancy/voxel_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

namespace {

constexpr double kDepthUnit = 0x1p-24;
constexpr double kAreaUnit = 0x1p-14;
constexpr double kPi = 3.14159265358979323846;
constexpr int kAxisBits = 21;
constexpr std::int64_t kAxisOffset = std::int64_t{1} << (kAxisBits - 1);
constexpr std::uint64_t kAxisMask = (std::uint64_t{1} << kAxisBits) - 1;
constexpr std::uint32_t kSlotsATask = 256;
constexpr std::size_t kSharesAtOnce = 1024;  // that a thread gathers for a shard

// z, y, x from the highest bits down, so that keys sort as cells do.
std::uint64_t keyOf(const std::array<std::int64_t, 3>& cell) {
  std::uint64_t key = 0;
  for (int axis = 2; axis >= 0; --axis) {
    key = key << kAxisBits | std::uint64_t(cell[axis] + kAxisOffset);
  }
  return key;
}

std::array<std::int32_t, 3> cellOf(std::uint64_t key) {
  std::array<std::int32_t, 3> cell;
  for (int axis = 0; axis < 3; ++axis, key >>= kAxisBits) {
    cell[axis] = static_cast<std::int32_t>(std::int64_t(key & kAxisMask) - kAxisOffset);
  }
  return cell;
}

// A hash for shards and their maps: neighbouring voxels lie far apart.
std::uint64_t mixed(std::uint64_t key) {
  key = (key ^ key >> 30) * 0xbf58476d1ce4e5b9u;  // splitmix64 (Steele et al. 2014)
  key = (key ^ key >> 27) * 0x94d049bb133111ebu;
  return key ^ key >> 31;
}

double depthOf(std::uint64_t sum) { return double(std::int64_t(sum)) * kDepthUnit; }
double areaOf(std::uint32_t sum) { return double(std::int32_t(sum)) * kAreaUnit; }

std::uint64_t toDepth(double value) { return std::uint64_t(std::llround(value / kDepthUnit)); }
std::uint32_t toArea(double value) { return std::uint32_t(std::llround(value / kAreaUnit)); }

using Matrix = std::array<double, 9>;

// The direction of the largest eigenvalue of a symmetric matrix, by squaring it again and again.
std::array<float, 3> principal(Matrix m) {
  for (int step = 0; step < 8; ++step) {
    const double trace = m[0] + m[4] + m[8];
    if (!(trace > 0)) return {0, 0, 1};
    for (double& value : m) value /= trace;
    m = product(m, m);
  }
  int column = 0;  // the longest: others may be zero
  for (int other = 1; other < 3; ++other) {
    if (m[4 * other] > m[4 * column]) column = other;
  }
  const double x = m[column], y = m[3 + column], z = m[6 + column];
  const double length = std::sqrt(x * x + y * y + z * z);
  if (!(length > 0)) return {0, 0, 1};
  return {float(x / length), float(y / length), float(z / length)};
}

// Points along an axis of a splat, from -2 to 2 standard deviations, with weights that sum to 1.
struct Samples {
  static constexpr int kMost = 513;

  int count = 0;                         // 0 if there would be more than kMost
  std::array<double, kMost> at, weight;  // places in voxels

  // deviation: in voxels. A splat that is thin beside a voxel has one point.
  explicit Samples(double deviation) {
    const double to_either_side = std::round(4 * deviation);
    if (!(to_either_side <= kMost / 2)) return;
    const int steps = int(to_either_side);
    count = 2 * steps + 1;
    double total = 0;
    for (int i = 0; i < count; ++i) {
      const double place = steps > 0 ? 2.0 * (i - steps) / steps : 0.0;  // in standard deviations
      at[i] = place * deviation;
      total += weight[i] = std::exp(-0.5 * place * place);
    }
    for (int i = 0; i < count; ++i) weight[i] /= total;
  }
};

}  // namespace

void VoxelMap::Voxel::operator+=(const Voxel& other) {
  for (int i = 0; i < 3; ++i) {
    depth[i] += other.depth[i];
    color[i] += other.color[i];
    offset[i] += other.offset[i];
  }
  for (int i = 0; i < 6; ++i) normal[i] += other.normal[i];
}

bool VoxelMap::Voxel::empty() const {
  constexpr Voxel kNothing;
  static_assert(std::has_unique_object_representations_v<Voxel>);
  return std::memcmp(this, &kNothing, sizeof(kNothing)) == 0;
}

std::size_t VoxelMap::Hash::operator()(std::uint64_t key) const { return mixed(key); }

VoxelMap::VoxelMap(const VoxelGrid& grid, unsigned threads) : grid_(grid), team_(threads) {
  if (!(grid.resolution > 0) || grid.across < 2 || grid.across > VoxelGrid::kMostAcross) {
    throw std::invalid_argument("a grid has voxels of more than 0 m, 2 to 4096 along each axis");
  }
}

void VoxelMap::apply(const GaussianEdit& edit) {
  const bool whole = whole_;
  whole_ = false;  // until the edit is done
  if (edit.clear) {
    clear();
  } else if (whole) {
    sum(partsOf(edit), -1);
  }
  slots_.apply(edit, 0, &team_);
  if (whole || edit.clear) {
    sum(partsOf(edit), 1);
  } else {
    rebuild();
  }
  whole_ = true;
}

void VoxelMap::place(const Placement& map_in_grid) {
  map_in_grid_ = map_in_grid;
  whole_ = false;
  rebuild();
  whole_ = true;
}

void VoxelMap::clear() {
  for (Shard& shard : shards_) decltype(shard.voxels)().swap(shard.voxels);
  count_ = too_large_ = beyond_ = 0;
  full_ = false;
}

void VoxelMap::rebuild() {
  clear();
  sum(allParts(), 1);
}

// Runs may overlap.
void VoxelMap::joinOverlaps(std::vector<PageSpan>& parts) {
  std::sort(parts.begin(), parts.end(), [](const PageSpan& a, const PageSpan& b) {
    return std::pair(a.page->first_slot, a.first) < std::pair(b.page->first_slot, b.first);
  });
  std::size_t joined = 0;
  for (const PageSpan part : parts) {
    PageSpan* const last = joined > 0 ? &parts[joined - 1] : nullptr;
    if (last && last->page == part.page && part.first <= last->first + last->count) {
      last->count = std::max(last->first + last->count, part.first + part.count) - last->first;
    } else {
      parts[joined++] = part;
    }
  }
  parts.resize(joined);
}

// The slots that an edit changes, none twice: it writes slots, empties slots or moves groups.
std::vector<VoxelMap::PageSpan> VoxelMap::partsOf(const GaussianEdit& edit) const {
  std::vector<PageSpan> parts;
  forEachPart(edit.runs, [&](std::uint32_t slot, std::uint32_t count, std::size_t) {
    const SlotPage* const page = slots_.index().find(slot);
    if (!page) return;
    // Splats of another group empty a page as a whole.
    const bool emptied = edit.sh_degree >= 0 && slots_.index().groupOf(*page).number != edit.group;
    parts.push_back(emptied ? PageSpan{page, 0, SlotPage::kSlots}
                            : PageSpan{page, slot % SlotPage::kSlots, count});
  });
  joinOverlaps(parts);
  if (edit.moves.empty()) return parts;
  std::vector<std::uint32_t> moved;
  for (const GroupMove& move : edit.moves) moved.push_back(move.group);
  std::sort(moved.begin(), moved.end());
  for (const PageSpan& part : allParts()) {
    const std::uint32_t group = slots_.index().groupOf(*part.page).number;
    if (std::binary_search(moved.begin(), moved.end(), group)) parts.push_back(part);
  }
  return parts;
}

std::vector<VoxelMap::PageSpan> VoxelMap::allParts() const {
  std::vector<PageSpan> parts;
  for (const SlotPage& page : slots_.pages()) parts.push_back({&page, 0, SlotPage::kSlots});
  return parts;
}

void VoxelMap::sum(const std::vector<PageSpan>& parts, int sign) {
  if (full_ || parts.empty()) return;
  std::vector<std::size_t> tasks{0};  // the first part of each task, and the end
  std::uint32_t slots = 0;
  for (std::size_t part = 0; part < parts.size(); ++part) {
    if (slots > 0 && slots + parts[part].count > kSlotsATask) {
      tasks.push_back(part);
      slots = 0;
    }
    slots += parts[part].count;
  }
  tasks.push_back(parts.size());
  std::vector<Shares> shares(team_.size());  // by member
  inParts(&team_, tasks.size() - 1, [&](std::size_t number, unsigned member) {
    for (std::size_t part = tasks[number]; part < tasks[number + 1]; ++part) {
      if (count_ > grid_.most) return;
      share(parts[part], sign, shares[member]);
    }
  });
  inParts(&team_, kShards, [&](std::size_t number) {
    for (Shares& each : shares) hand(number, each);
  });
  if (count_ <= grid_.most) return;
  clear();
  full_ = true;
}

void VoxelMap::hand(std::size_t number, Shares& shares) {
  Shard& shard = shards_[number];
  const std::lock_guard lock(shard.mutex);
  for (const Share& each : shares.of[number]) {
    const auto [found, added] = shard.voxels.try_emplace(each.key);
    if (added) ++count_;
    found->second += each.voxel;
    if (found->second.empty()) {
      shard.voxels.erase(found);
      --count_;
    }
  }
  shares.of[number].clear();
}

void VoxelMap::share(const PageSpan& part, int sign, Shares& shares) {
  const HostSlots::Page& page = slots_.at(*part.page);
  const Group& group = slots_.index().groupOf(*part.page);
  Placement in_map = group.place;
  in_map.translation = group.place(group.originOrZero());
  const Placement in_grid = map_in_grid_ * in_map;
  for (std::uint32_t i = part.first; i < part.first + part.count; ++i) {
    if (!(page.extent[i] >= 0)) continue;
    share(unpackSlot(page.packed(i, 0).words.data()), in_grid, sign, shares);
  }
}

void VoxelMap::share(const Splat& splat, const Placement& in_grid, int sign, Shares& shares) {
  const std::int64_t half = grid_.across / 2;
  std::array<double, 3> centre{};  // in voxels
  const std::array<double, 3> there =
      in_grid({splat.position[0], splat.position[1], splat.position[2]});
  for (int axis = 0; axis < 3; ++axis) {
    centre[axis] = there[axis] / grid_.resolution;
    if (!(centre[axis] >= double(-half) && centre[axis] < double(half))) {
      beyond_ += std::uint64_t(sign);
      return;
    }
  }
  const auto& [qx, qy, qz, qw] = splat.orientation;
  const Matrix axes = product(in_grid.rotation, makePlacement({}, {qx, qy, qz, qw}).rotation);
  std::array<double, 3> deviation;  // in voxels
  for (int k = 0; k < 3; ++k) deviation[k] = splat.scale[k] / grid_.resolution;
  const std::array<Samples, 3> along{Samples(deviation[0]), Samples(deviation[1]),
                                     Samples(deviation[2])};
  const double samples = double(along[0].count) * along[1].count * along[2].count;
  if (samples < 1 || samples > kMostSamples) {
    too_large_ += std::uint64_t(sign);
    return;
  }

  // The area that the whole splat hides, in faces of a voxel: `depth` as seen along each axis of
  // the grid, `area` as seen along the splat's shortest axis, which is its normal.
  const int shortest =
      int(std::min_element(deviation.begin(), deviation.end()) - deviation.begin());
  std::array<double, 3> faces;  // of the splat, seen along its own axes
  for (int k = 0; k < 3; ++k) {
    faces[k] = 2 * kPi * splat.opacity * deviation[(k + 1) % 3] * deviation[(k + 2) % 3];
  }
  std::array<double, 3> depth{};
  for (int axis = 0; axis < 3; ++axis) {
    for (int k = 0; k < 3; ++k) {
      const double seen = faces[k] * axes[3 * axis + k];
      depth[axis] += seen * seen;
    }
    depth[axis] = std::sqrt(depth[axis]);
  }
  const double area = faces[shortest];
  const std::array<double, 3> normal{axes[shortest], axes[3 + shortest], axes[6 + shortest]};

  std::uint64_t key = 0;
  double weight = 0;  // of the points so far in voxel `key`
  std::array<double, 3> offset{};
  const auto put = [&] {
    if (weight == 0) return;
    const std::size_t shard = mixed(key) >> 60;
    if (shares.of[shard].size() >= kSharesAtOnce) hand(shard, shares);
    Share& made = shares.of[shard].emplace_back();
    made.key = key;
    Voxel& voxel = made.voxel;
    for (int i = 0, number = 0; i < 3; ++i) {
      voxel.depth[i] = toDepth(sign * weight * depth[i]);
      const double color = std::clamp(0.5 + kShC0 * splat.color[i], 0.0, 1.0);
      voxel.color[i] = toArea(sign * weight * area * color);
      voxel.offset[i] = toArea(sign * area * offset[i]);
      for (int j = i; j < 3; ++j, ++number) {
        voxel.normal[number] = toArea(sign * weight * area * normal[i] * normal[j]);
      }
    }
  };
  for (int a = 0; a < along[0].count; ++a) {
    for (int b = 0; b < along[1].count; ++b) {
      for (int c = 0; c < along[2].count; ++c) {
        const std::array<double, 3> own{along[0].at[a], along[1].at[b], along[2].at[c]};
        std::array<double, 3> point = centre;
        std::array<std::int64_t, 3> cell;
        bool inside = true;
        for (int axis = 0; axis < 3; ++axis) {
          for (int k = 0; k < 3; ++k) point[axis] += axes[3 * axis + k] * own[k];
          cell[axis] = std::int64_t(std::floor(point[axis]));
          inside = inside && cell[axis] >= -half && cell[axis] < half;
        }
        if (!inside) continue;
        if (const std::uint64_t here = keyOf(cell); here != key) {
          put();
          key = here;
          weight = 0;
          offset = {};
        }
        const double mine = along[0].weight[a] * along[1].weight[b] * along[2].weight[c];
        weight += mine;
        for (int axis = 0; axis < 3; ++axis) {
          offset[axis] += mine * (point[axis] - double(cell[axis]));
        }
      }
    }
  }
  put();
}

VoxelSurface VoxelMap::find(double least_depth, bool surface) const {
  std::vector<std::pair<std::uint64_t, const Voxel*>> found;
  for (const Shard& shard : shards_) {
    for (const auto& [key, voxel] : shard.voxels) {
      const auto& [x, y, z] = voxel.depth;
      if (std::max({depthOf(x), depthOf(y), depthOf(z)}) >= least_depth) {
        found.emplace_back(key, &voxel);
      }
    }
  }
  std::sort(found.begin(), found.end());
  VoxelSurface result;
  result.cells.reserve(found.size());
  for (const auto& [key, voxel] : found) {
    const std::array<std::int32_t, 3> cell = cellOf(key);
    result.cells.push_back(cell);
    const auto& [x, y, z] = voxel->depth;
    result.depths.push_back({float(depthOf(x)), float(depthOf(y)), float(depthOf(z))});
    if (!surface) continue;
    std::array<double, 6> n;
    std::transform(voxel->normal.begin(), voxel->normal.end(), n.begin(), areaOf);
    result.normals.push_back(principal({n[0], n[1], n[2], n[1], n[3], n[4], n[2], n[4], n[5]}));
    const double area = n[0] + n[3] + n[5];
    std::array<float, 3> position, color;
    for (int i = 0; i < 3; ++i) {
      const double share = area > 0 ? areaOf(voxel->offset[i]) / area : 0.5;
      position[i] = float(grid_.resolution * (cell[i] + std::clamp(share, 0.0, 1.0)));
      color[i] = float(area > 0 ? std::clamp(areaOf(voxel->color[i]) / area, 0.0, 1.0) : 0.5);
    }
    result.positions.push_back(position);
    result.colors.push_back(color);
  }
  return result;
}

}  // namespace rosplat
