#pragma once

// The data that the stages of CpuRasterizer share. Only their sources include this.

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "raster/kernels.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"
#include "rosplat_core/threads/in_parts.hpp"
#include "rosplat_core/threads/scratch_buffer.hpp"
#include "rosplat_core/views/seen_group.hpp"

namespace rosplat {

namespace cpu {

constexpr std::uint32_t kSlots = HostSlots::kSlots;
constexpr std::uint32_t kNotOrdered = 0xffffffffu;
constexpr float kOpen = 2, kEnded = -1;  // as Pyramid::open: all may be seen, none may

// A range of the dealt candidates, all nearer than those of the next slice.
struct DepthSlice {
  std::size_t begin, end;
};

// A splat on a tile.
struct Pair {
  std::uint32_t tile, record;
};

// A growing array of pairs. Pairs are written first and counted in `size` afterwards.
struct PairList {
  // Makes room for `more` pairs; returns where to write them.
  Pair* makeRoom(std::size_t more) {
    if (size + more > room) {
      const std::size_t larger = size + more + room / 2;
      std::unique_ptr<Pair[]> memory(new Pair[larger]);
      std::copy_n(pairs.get(), size, memory.get());
      pairs = std::move(memory);
      room = larger;
    }
    return pairs.get() + size;
  }

  std::unique_ptr<Pair[]> pairs;
  std::size_t size = 0, room = 0;
};

// A layer of the picture, as the kernels need it.
struct SeenLayer {
  std::vector<SeenGroup> groups;
  CullView cull;
  ProjectView project;
  std::size_t channel = 0;  // index in HostSlots::Page::channels
  double error = 0;         // [px]
  std::size_t drawn = 0;    // splats and nodes
};

// A page that the picture may show.
struct SeenPage {
  PageSlots slots;
  const SlotPage* page;
  std::uint32_t layer;
};

// A share of a step, and the step's results for it.
struct StepShare {
  std::size_t begin = 0, end = 0;
  std::vector<std::size_t> slices;    // candidates by slice, then where the next one goes
  std::vector<std::uint32_t> counts;  // pairs by tile, then where the next one goes
  PairList pairs;
  std::size_t drawn = 0;               // records
  std::vector<std::size_t> of_layers;  // records by layer
};

// The rectangle of a picture that a tile covers.
struct TileRect {
  TileRect(std::size_t tile, int across, int width_of_all, int height_of_all)
      : left(int(tile) % across * kTile),
        top(int(tile) / across * kTile),
        width(std::min(kTile, width_of_all - left)),
        height(std::min(kTile, height_of_all - top)),
        first(std::size_t(top) * std::size_t(width_of_all) + std::size_t(left)),
        stride(std::size_t(width_of_all)) {}

  // Calls each(pixel of the tile, pixel of the picture).
  template <typename Each>
  void forEach(const Each& each) const {
    for (int row = 0; row < height; ++row) {
      for (int column = 0; column < width; ++column) {
        each(std::size_t(kTile * row + column),
             first + std::size_t(row) * stride + std::size_t(column));
      }
    }
  }

  int left, top, width, height;  // [px]
  std::size_t first, stride;
};

}  // namespace cpu

using namespace cpu;

struct CpuRasterizer::Work {
  Work(std::shared_ptr<ThreadTeam> with, const Kernels& fastest)
      : team(std::move(with)), kernels(fastest), members(team->size()) {}

  // The workspace of one member of the team.
  struct Member {
    TilePixels pixels, behind;
    alignas(64) float opaque[kTilePixels], divided[kTilePixels], most[kTilePixels];
    alignas(64) std::uint32_t indices[kTilePixels];
    ScratchBuffer<Listed> spare;
    std::vector<std::uint16_t> places, numbers, kept;
    std::vector<Footprint> footprints;
  };

  // The outputs of run(): a picture, or picks, or contributions with the picture for them.
  struct Wanted {
    SplatPicture* picture = nullptr;
    std::vector<std::uint32_t>* picked = nullptr;  // Record::index, kNoSlot where there is none
    Contributions* contributions = nullptr;
    bool drawn = false;  // `picture` is drawn already; only contributions are to be found

    bool blends() const { return picture && !drawn; }
  };

  bool run(const PictureRequest& request, const Wanted& wanted);
  void begin(const PictureRequest& request);
  void makeRoom(const PictureRequest& request, const Wanted& wanted);
  void setViews(const PictureRequest& request);
  void setView(const PictureLayer& layer, const PictureRequest& request, SeenLayer& seen);
  void setOrder(const HostSlots& slots, const ArrayView<std::uint32_t>& order);
  void choosePages(const PictureLayer& layer, std::uint32_t number);
  void choose(const SlotPage& page, const HostSlots::Page& memory, std::uint32_t layer);
  void cull();
  void deal();
  void halve(std::size_t number);
  void openTiles(const PictureRequest& request);
  void raisePyramid();
  bool hidden(const SeenPage& page) const;
  PickedSplat splatOf(std::uint32_t index) const;
  void findTiles(const Footprint& footprint, std::uint32_t record, StepShare& part) const;
  bool project(const DepthSlice& slice);
  void list();
  void drawTiles(const PictureRequest& request, const Wanted& wanted, bool first, bool contributes);
  void finish(const PictureRequest& request, SplatPicture& picture);
  void findMeanDepths(const PictureRequest& request, SplatPicture& picture);
  void blend(const PictureRequest& request, SplatPicture& picture, bool first, std::size_t tile,
             Member& member);
  void blendSamples(const PictureRequest& request, SplatPicture& picture, bool first,
                    std::size_t tile, Member& member);
  void pick(const PictureRequest& request, std::vector<std::uint32_t>& picked, bool first,
            std::size_t tile, Member& member);
  void contribute(const PictureRequest& request, const SplatPicture& picture, bool first,
                  std::size_t tile, Member& member);
  void addUp(Contributions& contributions);
  // Returns what blending, picking and contributing have in common.
  ListedTile listedTile(const PictureRequest& request, const TileRect& rect, std::size_t tile,
                        Member& member) const;
  void sortTile(std::size_t tile, Member& member);
  std::size_t inTile(std::size_t tile) const { return begins[tile + 1] - begins[tile]; }
  void findDepthRanges();

  // Calls step(part, member) for parts of [0, count), in parallel. Throws std::bad_alloc.
  template <typename Step>
  void inParts(std::size_t count, std::size_t least_share, const Step& step);
  bool cancelled() const { return cancel && cancel->load(std::memory_order_relaxed); }
  void lap(const char* stage) {
    const std::chrono::steady_clock::time_point now = std::chrono::steady_clock::now();
    profile[stage] += std::chrono::duration<double>(now - began).count();
    began = now;
  }

  std::shared_ptr<ThreadTeam> team;
  const Kernels& kernels;
  std::vector<Member> members;
  std::vector<StepShare> parts;

  std::vector<SeenLayer> layers;
  std::vector<SeenPage> pages;  // layer by layer, in the order of slots, nodes last
  std::array<HostSlots::PerSlot<float>, kLevels + 1> node_parents;  // PageSlots::parents, by theirs
  ScratchBuffer<std::uint32_t> ranks;  // PictureRequest::order's, by place * kSlots + slot in page
  bool ordered = false;                // the request has an order
  Candidate* found = nullptr;  // in the memory of `records`, which are written after dealing
  ScratchBuffer<Candidate> dealt;
  std::size_t candidates = 0;
  std::vector<DepthSlice> waiting;  // slices still to draw, the nearest one last
  std::vector<float> open;          // Pyramid::open
  std::vector<float> picking;       // by pixel: transmittance, largest contribution so far
  float ends_at = 0;                // a pixel ends at this transmittance
  SplatPicture seen;                // the picture that contribute() draws
  std::vector<float> remaining;     // by pixel: colour still to come from behind, transmittance
  ScratchBuffer<Contribution> of_listed;
  std::vector<Contribution> of_records;
  Pyramid pyramid;
  int levels = 0;
  bool hides = false;  // some tile isn't kOpen
  ScratchBuffer<Record> records;
  ScratchBuffer<RayShape> shapes;     // by record, in a picture of conics
  bool conics = false;                // some layer's model isn't EWA
  bool planes = false;                // of ellipses: PictureRequest::planes
  ScratchBuffer<std::uint32_t> keys;  // by record
  ScratchBuffer<Listed> listed;
  std::vector<std::size_t> begins;  // where each tile's part of `listed` begins, and the end
  int across = 0, down = 0;         // tiles
  std::size_t tiles = 0, pixels = 0, total_pairs = 0;

  const std::atomic<bool>* cancel = nullptr;
  std::map<std::string, double> profile;
  std::chrono::steady_clock::time_point began;
};

template <typename Step>
void CpuRasterizer::Work::inParts(std::size_t count, std::size_t least_share, const Step& step) {
  const std::size_t most = members.size() > 1 ? 2 * members.size() : 1;
  parts.resize(std::min(most, 1 + count / least_share));
  rosplat::inParts(team.get(), parts.size(), [&](std::size_t number, unsigned member) {
    StepShare& part = parts[number];
    part.begin = count * number / parts.size();
    part.end = count * (number + 1) / parts.size();
    step(part, members[member]);
  });
}

}  // namespace rosplat
