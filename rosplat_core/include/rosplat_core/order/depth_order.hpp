// The visible splats of a map, back to front: culling and an exact, stable radix sort by depth.
//
// All arithmetic is IEEE float32 with every operation rounded by itself, so that each sorter of the
// project finds the same order to the bit (the plain twin is rosplat_core/depth.py, which also
// derives the bounds used here). Compilers that fuse a * b + c, as GCC does for ARM, must be told
// not to: link the CMake target rosplat_core::rosplat_core, it carries -ffp-contract=off.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/threads/scratch_buffer.hpp"
#include "rosplat_core/threads/thread_team.hpp"
#include "rosplat_core/views/sort_view.hpp"

#ifdef __FAST_MATH__
#error "depth_order.hpp relies on IEEE arithmetic: compile without -ffast-math"
#endif
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

// Compiles a function twice, with AVX2 and without: a machine runs the best copy that it can.
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_THREAD__)  // ThreadSanitizer isn't ready when a copy is chosen
#define ROSPLAT_VECTORISED __attribute__((target_clones("avx2", "default")))
#else
#define ROSPLAT_VECTORISED
#endif

namespace rosplat {

// Neighbouring slots of a map, from first_slot on. Their rows begin at place * kSlots. A map has
// rows for its pages alone, as authors number slots as they like.
struct SortPage {
  static constexpr std::uint32_t kSlots = kPageSlots;

  std::uint32_t first_slot;
  std::uint32_t place;
  // Index of the view for positions in this page: one camera has a view for each group of a map.
  // The views differ in rotation and translation alone, so depths compare between groups.
  std::uint32_t view = 0;
};

// Orders splats by depth. Keeps its workspace and its threads between calls; one caller at a time.
class DepthOrder {
 public:
  // Threads to sort with, the caller's included; 0 takes as many as the machine runs at once.
  explicit DepthOrder(unsigned threads = 0) : DepthOrder(std::make_shared<ThreadTeam>(threads)) {}
  // Sorts with a team that others may share.
  explicit DepthOrder(std::shared_ptr<ThreadTeam> team)
      : team_(std::move(team)), scratch_(team_->size()) {}

  unsigned threads() const { return team_->size(); }

  // Finds the visible slots of pages, which must ascend, back to front; of equal depths the higher
  // slot first. positions: 3 a row [m]; extents: 1 a row [m], negative for slots that are never
  // visible. views: by SortPage::view. allocate(m) returns where the m visible slots go.
  template <typename Allocate>
  void sort(const SortView* views, const float* positions, const float* extents,
            const SortPage* pages, std::size_t page_count, const Allocate& allocate) {
    sort(Splats{views, positions, extents, pages, page_count * SortPage::kSlots}, allocate);
  }

  // Returns the depth along the optical axis that sort() orders by [m].
  static float depth(const SortView& view, const float* position) {
    return transform(view, 2, position);
  }

 private:
  static constexpr std::size_t kBlock = 512;  // splats culled at a time, in L1
  static_assert(SortPage::kSlots % kBlock == 0, "a block lies in one page");
  static constexpr std::size_t kLeastShare = 1u << 15;   // splats worth waking a thread for
  static constexpr std::size_t kBucketSize = 1u << 13;   // entries worth a bucket
  static constexpr unsigned kMostBuckets = 256;          // a cache line of each stays in L1
  static constexpr std::size_t kSamples = 16;            // sampled depths per bucket
  static constexpr std::size_t kCells = 1u << 14;        // cells of depth, which make up buckets
  static constexpr std::size_t kMostScratch = 1u << 17;  // entries, in L2
  static constexpr unsigned kDigitBits = 9;              // 512 targets stay in L1 and its TLB

  // The count slots of `pages`.
  struct Splats {
    const SortView& view(std::size_t i) const { return views[pages[i / SortPage::kSlots].view]; }
    std::uint32_t slot(std::size_t i) const {
      return pages[i / SortPage::kSlots].first_slot + std::uint32_t(i % SortPage::kSlots);
    }
    std::size_t row(std::size_t i) const {
      return std::size_t{pages[i / SortPage::kSlots].place} * SortPage::kSlots +
             i % SortPage::kSlots;
    }

    const SortView* views;
    const float* positions;
    const float* extents;
    const SortPage* pages;
    std::size_t count;
  };

  struct Entry {
    std::uint32_t key;
    std::uint32_t slot;
  };

  // A share of the splats; after cull() the range of the entries found there.
  struct SortShare {
    std::size_t begin;
    std::size_t end;
    std::array<std::size_t, kMostBuckets> buckets;  // counts; after shareOut() the next targets
  };

  static float transform(const SortView& view, int axis, const float* p) {
    const float* r = view.rotation + 3 * axis;
    return ((r[0] * p[0] + r[1] * p[1]) + r[2] * p[2]) + view.translation[axis];
  }

  // Whether any of a splat's footprint can touch the picture; false if float32 can't hold the
  // position (infinite or NaN). w: 1 if orthographic, else z.
  static bool visible(const SortView& view, float x, float y, float z, float w, float extent) {
    const bool in_depth = (extent >= 0.0f) & (z > view.near_clip) & (z < view.far_clip);
    const bool in_width =
        std::fabs(view.fx * x + view.offset_x * w) <= view.half_width * w + view.slope_x * extent;
    const bool in_height =
        std::fabs(view.fy * y + view.offset_y * w) <= view.half_height * w + view.slope_y * extent;
    return in_depth & in_width & in_height;
  }

  // Maps a depth to an unsigned integer. Keys compare as the depths do.
  static std::uint32_t key(float depth) {
    depth += 0.0f;  // -0 and 0 are the same depth
    std::uint32_t bits;
    std::memcpy(&bits, &depth, sizeof(bits));
    const std::uint32_t negative = 0u - (bits >> 31);
    return bits ^ (negative | 0x80000000u);
  }

  // Writes the keys of the depths of count splats, and 1 for visible ones, else 0. No branches, and
  // a loop for each projection, so that compilers vectorise.
  ROSPLAT_VECTORISED
  static void findVisible(const SortView& camera, const float* positions, const float* extents,
                          std::size_t count, std::uint32_t* keys, std::uint32_t* seen) {
    const SortView view = camera;  // a copy that no store below can alias
    const auto each = [&](auto w_of) {
      for (std::size_t i = 0; i < count; ++i) {
        const float* p = positions + 3 * i;
        const float z = transform(view, 2, p);
        keys[i] = key(z);
        seen[i] =
            visible(view, transform(view, 0, p), transform(view, 1, p), z, w_of(z), extents[i]);
      }
    };
    if (view.orthographic) {
      each([](float) { return 1.0f; });
    } else {
      each([](float z) { return z; });
    }
  }

  // Deals the visible splats out to buckets of depths, chosen by samples (Frazer and McKellar 1970,
  // "Samplesort"), then sorts each bucket in the cache: two passes through memory, not one a digit.
  template <typename Allocate>
  void sort(const Splats& splats, const Allocate& allocate) {
    chooseBuckets(splats);
    const unsigned members = team_->size();
    // Twice as many shares as members, so that a member that wakes late leaves some to the others.
    parts_.resize(
        std::min<std::size_t>(members > 1 ? 2 * members : 1, 1 + splats.count / kLeastShare));
    const auto parts = static_cast<unsigned>(parts_.size());
    Entry* const found = found_.fit(splats.count);
    team_->run(parts, [&](unsigned number, unsigned) {
      SortShare& part = parts_[number];
      const std::size_t blocks = (splats.count + kBlock - 1) / kBlock;
      part.begin = blocks * number / parts * kBlock;
      part.end = std::min(blocks * (number + 1) / parts * kBlock, splats.count);
      cull(splats, found, part);
    });

    const std::size_t total = shareOut();
    Entry* const dealt = dealt_.fit(total);
    team_->run(parts, [&](unsigned number, unsigned) {
      SortShare& part = parts_[number];
      for (std::size_t i = part.begin; i < part.end; ++i) {
        dealt[part.buckets[bucketOf(found[i].key)]++] = found[i];
      }
    });
    std::uint32_t* const order = allocate(total);
    team_->run(buckets_, [&](unsigned bucket, unsigned member) {
      const std::size_t begin = begins_[bucket];
      const std::size_t size = begins_[bucket + 1] - begin;
      Entry* const spare = size > kMostScratch ? found + begin : scratch_[member].get();
      // Slots by ascending depth are written from the end on: back to front.
      sortBucket(dealt + begin, size, spare, order + total - begin);
    });
  }

  // Chooses buckets with about as many splats in each. Equal depths share a bucket.
  void chooseBuckets(const Splats& splats) {
    const auto worth = [](std::size_t entries) {
      return static_cast<unsigned>(std::clamp<std::size_t>(entries / kBucketSize, 1, kMostBuckets));
    };
    buckets_ = worth(splats.count);
    bucket_of_cell_.fill(0);
    if (buckets_ == 1) return;

    const std::size_t tries = kSamples * buckets_;
    samples_.clear();
    for (std::size_t i = 0; i < tries; ++i) {
      const std::size_t sample = splats.count * i / tries;
      const std::size_t row = splats.row(sample);
      std::uint32_t key;
      std::uint32_t seen;
      findVisible(splats.view(sample), splats.positions + 3 * row, splats.extents + row, 1, &key,
                  &seen);
      if (seen) samples_.push_back(key);
    }
    buckets_ = worth(splats.count / tries * samples_.size());
    if (buckets_ == 1) return;

    // The cells span the bulk of the sampled depths. Depths beyond fall in the outermost cells.
    std::sort(samples_.begin(), samples_.end());
    const std::size_t beyond = samples_.size() / (2 * buckets_);
    first_cell_ = samples_[beyond];
    const std::uint32_t span = samples_[samples_.size() - 1 - beyond] - first_cell_;
    cell_shift_ = 0;
    while (span >> cell_shift_ >= kCells) ++cell_shift_;
    for (unsigned bucket = 1; bucket < buckets_; ++bucket) {
      const std::size_t cell = cellOf(samples_[samples_.size() * bucket / buckets_]);
      std::fill(bucket_of_cell_.begin() + cell, bucket_of_cell_.end(),
                static_cast<std::uint8_t>(bucket));
    }
  }

  std::size_t cellOf(std::uint32_t key) const {
    return std::min<std::size_t>((key - std::min(key, first_cell_)) >> cell_shift_, kCells - 1);
  }
  unsigned bucketOf(std::uint32_t key) const { return bucket_of_cell_[cellOf(key)]; }

  // Finds where each part's entries go; returns the number of all entries.
  std::size_t shareOut() {
    std::size_t next = 0;
    std::size_t largest = 0;
    begins_.clear();
    for (unsigned bucket = 0; bucket < buckets_; ++bucket) {
      begins_.push_back(next);
      for (SortShare& part : parts_) next += std::exchange(part.buckets[bucket], next);
      largest = std::max(largest, next - begins_.back());
    }
    begins_.push_back(next);
    for (auto& scratch : scratch_) scratch.fit(std::min(largest, kMostScratch));
    return next;
  }

  // Writes an entry for each visible splat of [part.begin, part.end), counts the entries by bucket,
  // and shortens the part to them.
  void cull(const Splats& splats, Entry* entries, SortShare& part) const {
    std::array<std::uint32_t, kBlock> keys;
    std::array<std::uint32_t, kBlock> seen;
    Entry* out = entries + part.begin;
    const Entry* counted = out;
    part.buckets.fill(0);
    for (std::size_t first = part.begin; first < part.end; first += kBlock) {
      const std::size_t size = std::min(kBlock, part.end - first);  // in one page, of one view
      const std::size_t row = splats.row(first);
      findVisible(splats.view(first), splats.positions + 3 * row, splats.extents + row, size,
                  keys.data(), seen.data());
      const std::uint32_t slot = splats.slot(first);
      for (std::size_t i = 0; i < size; ++i) {
        *out = {keys[i], slot + std::uint32_t(i)};
        out += seen[i];
      }
      for (; counted < out; ++counted) ++part.buckets[bucketOf(counted->key)];
    }
    part.end = static_cast<std::size_t>(out - entries);
  }

  // Least significant digit first radix sort, over the bits in which the keys differ. Writes the
  // slots before end; spare has room for the entries.
  static void sortBucket(Entry* from, std::size_t size, Entry* spare, std::uint32_t* end) {
    std::uint32_t least = ~0u;
    std::uint32_t greatest = 0;
    for (std::size_t i = 0; i < size; ++i) {
      least = std::min(least, from[i].key);
      greatest = std::max(greatest, from[i].key);
    }
    if (size == 0) return;

    unsigned bits = 0;
    while (bits < 32 && (greatest - least) >> bits != 0) ++bits;
    const unsigned passes = std::max(1u, (bits + kDigitBits - 1) / kDigitBits);
    const unsigned digit_bits = (bits + passes - 1) / passes;
    const std::uint32_t mask = (1u << digit_bits) - 1;
    std::array<std::uint32_t, 1u << kDigitBits> targets;
    for (unsigned pass = 0; pass < passes; ++pass, std::swap(from, spare)) {
      const unsigned shift = pass * digit_bits;
      const auto digit = [=](const Entry& e) { return ((e.key - least) >> shift) & mask; };
      targets.fill(0);
      for (std::size_t i = 0; i < size; ++i) ++targets[digit(from[i])];
      std::exclusive_scan(targets.begin(), targets.end(), targets.begin(), 0u);
      if (pass + 1 < passes) {
        for (std::size_t i = 0; i < size; ++i) spare[targets[digit(from[i])]++] = from[i];
      } else {
        for (std::size_t i = 0; i < size; ++i) {
          end[-static_cast<std::ptrdiff_t>(++targets[digit(from[i])])] = from[i].slot;
        }
      }
    }
  }

  std::shared_ptr<ThreadTeam> team_;
  std::vector<std::uint32_t> samples_;  // keys
  unsigned buckets_ = 1;
  std::uint32_t first_cell_ = 0;  // the first cell's first key
  unsigned cell_shift_ = 0;       // log2 of the number of keys in a cell
  std::array<std::uint8_t, kCells> bucket_of_cell_;
  std::vector<std::size_t> begins_;  // where each bucket begins, and where the last one ends
  std::vector<SortShare> parts_;
  ScratchBuffer<Entry> found_;
  ScratchBuffer<Entry> dealt_;
  std::vector<ScratchBuffer<Entry>> scratch_;  // one for each member
};

}  // namespace rosplat
