#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/map/placement.hpp"
#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// A grid of cubes around a frame's origin. A voxel is named by x, y, z; its corner is at these
// times the resolution.
struct VoxelGrid {
  static constexpr int kMostAcross = 4096;

  double resolution = 0.05;  // edge of a voxel [m]
  int across = 2048;         // voxels along each axis; coordinates are -across/2 to across/2 - 1
  std::size_t most = std::size_t{1} << 24;  // voxels to hold at most: 2 GB
};

// The surface that voxels of a map hold: in each array, one entry a voxel.
struct VoxelSurface {
  std::vector<std::array<std::int32_t, 3>> cells;
  std::vector<std::array<float, 3>> depths;     // optical depth along x, y, z
  std::vector<std::array<float, 3>> positions;  // mean of the splats' surface [m]
  std::vector<std::array<float, 3>> normals;    // of unit length, of either sign
  std::vector<std::array<float, 3>> colors;     // RGB of band 0, not clamped
};

// How much light the splats of a map take away in each voxel.
//
// Of the light along an axis, a splat of opacity o takes away A = 2 pi o sqrt(det S), where S is
// its 2x2 covariance as seen along that axis: the integral of its alpha. A voxel's optical depth
// along an axis is the sum of A / resolution^2 over its splats, each splat spread over the voxels
// that it lies in. A surface that closes has a depth of 1 and more along some axis, however thin it
// is.
//
// Depths are sums of integers, so an edit takes away exactly what an earlier one added: a map after
// many edits equals one that was built at once, to the bit.
class VoxelMap {
 public:
  // threads: 0 for as many as the machine runs at once.
  explicit VoxelMap(const VoxelGrid& grid, unsigned threads = 0);

  // Throws std::bad_alloc: then the next edit builds all voxels anew.
  void apply(const GaussianEdit& edit);
  // Places the map's frame in the grid's frame. Builds all voxels anew.
  void place(const Placement& map_in_grid);

  // Voxels whose depth along some axis is `least_depth` or more, ordered by z, y, x. surface: fills
  // all arrays, otherwise only cells and depths.
  VoxelSurface find(double least_depth, bool surface) const;

  // How many splats are left out as too large for the resolution: each would take more than
  // kMostSamples points, half a voxel apart.
  std::uint64_t tooLarge() const { return too_large_; }
  // How many splats are left out because their centre is beyond the grid.
  std::uint64_t beyond() const { return beyond_; }
  std::size_t voxels() const { return count_; }
  std::size_t most() const { return grid_.most; }
  // Whether there would be more voxels than most(). Then there are none until the map is cleared or
  // placed.
  bool full() const { return full_; }

  static constexpr int kMostSamples = 1 << 16;

 private:
  static constexpr std::size_t kShards = 16;
  // Sums over splats. Unsigned: an overflow is undone when its splats are taken away.
  struct Voxel {
    std::array<std::uint64_t, 3> depth{};   // in kDepthUnit
    std::array<std::uint32_t, 3> color{};   // from here on: weighted by area, in kAreaUnit
    std::array<std::uint32_t, 3> offset{};  // from the voxel's corner, in voxels
    std::array<std::uint32_t, 6> normal{};  // products: xx xy xz yy yz zz

    void operator+=(const Voxel& other);
    bool empty() const;
  };
  struct Hash {
    std::size_t operator()(std::uint64_t key) const;
  };
  struct Shard {
    std::mutex mutex;
    std::unordered_map<std::uint64_t, Voxel, Hash> voxels;
  };
  struct Share {
    std::uint64_t key;
    Voxel voxel;
  };
  // What a thread has still to add to each shard.
  struct Shares {
    std::array<std::vector<Share>, kShards> of;
  };
  // Slots of one page.
  struct PageSpan {
    const SlotPage* page;
    std::uint32_t first, count;
  };

  std::vector<PageSpan> partsOf(const GaussianEdit& edit) const;
  static void joinOverlaps(std::vector<PageSpan>& parts);
  std::vector<PageSpan> allParts() const;
  // sign: 1 to add what the slots hold, -1 to take it away.
  void sum(const std::vector<PageSpan>& parts, int sign);
  void share(const PageSpan& part, int sign, Shares& shares);
  void share(const Splat& splat, const Placement& in_grid, int sign, Shares& shares);
  void hand(std::size_t number, Shares& shares);  // adds them to shard `number`
  void clear();
  void rebuild();

  VoxelGrid grid_;
  ThreadTeam team_;
  Placement map_in_grid_;
  HostSlots slots_;
  std::array<Shard, kShards> shards_;
  std::atomic<std::size_t> count_{0};  // of voxels
  std::atomic<std::uint64_t> too_large_{0}, beyond_{0};
  bool whole_ = true;  // false: the voxels aren't those of the slots
  bool full_ = false;
};

}  // namespace rosplat
