#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "owned_batch.hpp"
#include "random_batches.hpp"
#include "rosplat_core/levels/level_builder.hpp"
#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"

namespace rosplat {
namespace {

bool never() { return false; }

// A map that is edited, and its levels.
struct Scene {
  explicit Scene(unsigned threads = 2) : levels(std::make_shared<ThreadTeam>(threads)) {}

  void write(std::uint32_t slot, std::array<float, 3> position, std::array<float, 3> scale,
             float opacity = 0.8f, std::array<float, 4> orientation = {0, 0, 0, 1}) {
    std::vector<float> sh(12);  // of degree 1, each its own
    for (int k = 0; k < 12; ++k) sh[std::size_t(k)] = std::sin(float(slot) + float(k));
    batch.slot_list.push_back(slot);
    batch.add(position, scale, opacity, sh, orientation);
  }
  void send(std::uint8_t operation = GaussianBatch::UPSERT) {
    batch.revision = map.state().revision + 1;
    batch.operation = operation;
    batch.sh_degree = 1;
    batch.group = group;
    BatchReport report;
    const auto edit = map.apply(batch.look(), report);
    if (edit->clear) levels.clear();
    slots.apply(*edit, 0);
    levels.mark(slots, edit->runs);
    batch = OwnedBatch();
  }
  void remove(std::vector<std::uint32_t> slots_to_empty) {
    batch.slot_list = std::move(slots_to_empty);
    batch.count = static_cast<std::uint32_t>(batch.slot_list.size());
    send(GaussianBatch::DELETE);
  }

  std::uint32_t group = 0;  // that is written to
  GaussianMap map;
  HostSlots slots;
  Levels levels;
  OwnedBatch batch;  // to be sent
};

struct Content {
  std::array<std::uint32_t, kSlotWords> words;
  std::array<std::array<std::uint32_t, 7>, kMaxShDegree + 1> bands;
  float extent;
  std::vector<std::uint32_t> members;

  bool operator==(const Content& o) const {
    return words == o.words && bands == o.bands && extent == o.extent && members == o.members;
  }
};

// Of a group, by index.
std::map<Cell, Content> nodesOf(const Levels& levels, std::size_t group = 0) {
  std::map<Cell, Content> nodes;
  if (group >= levels.groups().size()) return nodes;
  for (int level = 0; level < kLevels; ++level) {
    Cell before = 0;
    for (const auto& page : levels.groups()[group][std::size_t(level)]) {
      EXPECT_LE(page->cells.size(), SlotPage::kSlots);
      EXPECT_EQ(page->bounds.group, group);
      for (std::size_t i = 0; i < page->cells.size(); ++i) {
        const Node node = page->node(i, 1);
        EXPECT_EQ(levelOf(node.cell), level);
        EXPECT_TRUE(before == 0 || before < node.cell);
        before = node.cell;
        nodes[node.cell] = {node.packed.words, node.packed.bands, node.extent, node.members};
      }
    }
  }
  return nodes;
}

// What is drawn in place of each slot: the widths of its parent's cell.
std::map<std::uint32_t, float> parentsOf(const HostSlots& slots) {
  std::map<std::uint32_t, float> parents;
  for (const SlotPage& page : slots.pages()) {
    const HostSlots::Page& memory = slots.at(page);
    for (std::uint32_t i = 0; i < SlotPage::kSlots; ++i) {
      if (memory.extent[i] >= 0) {
        parents[page.first_slot + i] = memory.parents ? (*memory.parents)[i] : kBoundless;
      }
    }
  }
  return parents;
}

// As if the map had been there at once.
void expectAsBuiltAtOnce(const Scene& scene) {
  HostSlots copy;
  for (const SlotPage& page : scene.slots.pages()) copy.apply(scene.slots.edit(page), 0);
  Levels levels(std::make_shared<ThreadTeam>(1));
  ASSERT_TRUE(levels.advance(copy, never));
  const std::vector<Group>& groups = scene.slots.index().groups();
  for (const Group& group : copy.index().groups()) {
    const auto same = std::find_if(groups.begin(), groups.end(),
                                   [&](const Group& o) { return o.number == group.number; });
    EXPECT_TRUE(nodesOf(scene.levels, std::size_t(same - groups.begin())) ==
                nodesOf(levels, std::size_t(&group - copy.index().groups().data())));
  }
  EXPECT_EQ(scene.levels.nodes(), levels.nodes());
  EXPECT_EQ(parentsOf(scene.slots), parentsOf(copy));
  for (std::size_t group = 0; group < levels.groups().size(); ++group) {
    const auto nodes = nodesOf(levels, group);
    for (auto node = nodes.begin(); node != nodes.end(); ++node) {
      const int level = levelOf(node->first);
      if (parentSize(levels.groups()[group], level) == kBoundless) continue;
      EXPECT_EQ(nodes.count(parentOf(node->first)), 1u) << "a hole at level " << level;
    }
  }
}

TEST(Lattice, ACellLiesInItsParent) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(-1, 1);
  for (int i = 0; i < 1000; ++i) {
    const float far = std::exp(8 * unit(random));
    const std::array<float, 3> p{far * unit(random), far * unit(random), far * unit(random)};
    const Cell entry = entryOf(p, 0.01f * far);
    Cell cell = entry;
    for (int level = levelOf(cell); level + 1 < kLevels; ++level, cell = parentOf(cell)) {
      ASSERT_EQ(levelOf(cell), level);
      ASSERT_EQ(cell, cellAt(p, level));
      for (int axis = 0; axis < 3; ++axis) {
        ASSERT_LE(cornerOf(cell)[axis], p[axis]);
        ASSERT_GT(cornerOf(cell)[axis] + cellSize(level), p[axis]);
      }
      const Cell first = childrenOf(parentOf(cell));
      ASSERT_GE(cell, first);
      ASSERT_LT(cell, first + 8);
    }
    EXPECT_GT(cellSize(levelOf(entry)), 0.02f * far);
  }
}

TEST(Lattice, ParentsSortAsTheirChildren) {
  std::mt19937 random(2);
  std::uniform_real_distribution<float> unit(-100, 100);
  std::set<Cell> cells;
  for (int i = 0; i < 1000; ++i)
    cells.insert(cellAt({unit(random), unit(random), unit(random)}, 12));
  Cell before = 0;
  for (const Cell cell : cells) {
    EXPECT_LE(before, parentOf(cell));
    before = parentOf(cell);
  }
}

TEST(Lattice, WhatIsTooLargeOrTooFarHasNoCell) {
  EXPECT_EQ(entryOf({}, 1e6f), kNoCell);
  EXPECT_EQ(entryOf({1e12f, 0, 0}, 1), kNoCell);
  EXPECT_NE(entryOf({}, 0), kNoCell);
}

// A splat so wide that it enters the lattice at its last level, alone in an octant.
constexpr std::array<float, 3> kWidestAt{-8, -8, -8};
void writeWidest(Scene& scene, std::uint32_t slot) {
  scene.write(slot, kWidestAt, {cellSize(kLevels - 1) / 2.5f, 0, 0});
}
Cell widestCell() { return cellAt(kWidestAt, kLevels - 1); }

// The far splat enters at a level whose lattice is twice as wide as that of the level before.
TEST(Levels, HaveNoHolesBesideAFarSplat) {
  std::mt19937 random(4);
  std::uniform_real_distribution<float> near(-0.52f, -0.02f);
  for (const float far : {-1024.01f, 1024.01f}) {
    Scene scene;
    for (std::uint32_t slot = 0; slot < 60; ++slot) {
      scene.write(slot, {near(random), near(random), near(random)}, {0.001f, 0.001f, 0.001f});
    }
    scene.write(60, {far, -0.001f, -0.001f}, {0.001f, 0.001f, 0.001f});
    scene.send();
    ASSERT_TRUE(scene.levels.advance(scene.slots, never));
    expectAsBuiltAtOnce(scene);
    scene.write(0, {-0.3f, -0.3f, -0.3f}, {0.001f, 0.001f, 0.001f});
    scene.send();
    ASSERT_TRUE(scene.levels.advance(scene.slots, never));
    expectAsBuiltAtOnce(scene);
  }
}

TEST(Levels, EndWhereNothingMoreIsMerged) {
  Scene scene;
  const auto expectLast = [&](int last, std::size_t nodes) {
    ASSERT_TRUE(scene.levels.advance(scene.slots, never));
    const Levels::Nodes& levels = scene.levels.groups()[0];
    std::size_t count = 0;
    for (const auto& page : levels[std::size_t(last)]) count += page->cells.size();
    EXPECT_EQ(count, nodes);
    EXPECT_EQ(parentSize(levels, last), kBoundless);
    EXPECT_EQ(parentSize(levels, last - 1), cellSize(last));
    for (std::size_t level = std::size_t(last) + 1; level < kLevels; ++level) {
      EXPECT_TRUE(levels[level].empty());
    }
    expectAsBuiltAtOnce(scene);
  };
  const auto rowOf = [&](std::uint32_t count) {  // of splats, each in a cell of 1/8 m of its own
    for (std::uint32_t slot = 0; slot < count; ++slot) {
      scene.write(slot, {0.0625f + 0.125f * float(slot), 0.01f, 0.01f}, {0.06f, 0.01f, 0.01f});
    }
    scene.send();
  };
  const int entry = -3 - kFinestOctave;  // of these
  rowOf(8);
  expectLast(entry, 8);
  rowOf(9);
  expectLast(entry + 1, 5);
  writeWidest(scene, 9);
  scene.send();
  expectLast(kLevels - 1, 2);
  scene.remove({9});
  expectLast(entry + 1, 5);
  scene.remove({1, 3, 5});
  expectLast(entry, 6);
}

TEST(Levels, OfOneSplatAreThatSplat) {
  Scene scene;
  scene.write(7, {0.3f, -0.2f, 5}, {0.1f, 0.02f, 0.05f}, 0.5f, {0.5f, 0.5f, 0.1f, 0.7f});
  writeWidest(scene, 8);
  scene.send();
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  const PackedSlot splat = scene.slots.at(*scene.slots.index().find(7)).packed(7, 1);
  auto nodes = nodesOf(scene.levels);
  EXPECT_EQ(nodes.erase(widestCell()), 1u);
  const int entry = levelOf(nodes.begin()->first);
  EXPECT_EQ(nodes.size(), std::size_t(kLevels - entry));
  for (const auto& [cell, node] : nodes) {
    EXPECT_EQ(node.members, levelOf(cell) == entry ? std::vector<std::uint32_t>{7}
                                                   : std::vector<std::uint32_t>{});
    for (int k = 0; k < kSlotWords; ++k) {
      const std::uint32_t mask = k == 3 ? 0xffff0000u : 0xffffffffu;  // but for the opacity
      EXPECT_EQ(node.words[k] & mask, splat.words[k] & mask);
    }
    EXPECT_NEAR(float(node.words[3] & 0xffffu) / 65535 * kMostNodeOpacity, 0.5f, 2e-4f);
    EXPECT_EQ(node.bands, splat.bands);
  }
  EXPECT_EQ(parentsOf(scene.slots).at(7), cellSize(entry));
}

TEST(Levels, ANodeHasTheMomentsOfWhatIsInIt) {
  Scene scene;
  scene.write(0, {0.26f, 0.26f, 0.26f}, {0.1f, 0.1f, 0.1f}, 0.5f);
  scene.write(1, {0.30f, 0.26f, 0.26f}, {0.1f, 0.1f, 0.1f}, 0.5f);
  scene.send();
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  const auto nodes = nodesOf(scene.levels);
  const Splat node = unpackSlot(nodes.begin()->second.words.data());
  EXPECT_EQ(nodes.begin()->second.members, (std::vector<std::uint32_t>{0, 1}));
  EXPECT_NEAR(node.position[0], 0.28f, 1e-6f);
  EXPECT_NEAR(node.position[1], 0.26f, 1e-6f);
  const float widest = *std::max_element(node.scale.begin(), node.scale.end());
  EXPECT_NEAR(widest, std::sqrt(0.01f + 0.02f * 0.02f), 1e-4f);
  // Two of 0.5, one nearly on the other.
  EXPECT_GT(node.opacity * kMostNodeOpacity, 0.95f);
  EXPECT_LT(node.opacity * kMostNodeOpacity, 1);
}

TEST(Levels, AfterAnyEditsAreThoseOfAMapBuiltAtOnce) {
  for (unsigned seed = 0; seed < 12; ++seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> unit(0, 1);
    // Dense and sparse, near the origin and far from it.
    const float spread = std::exp(6 * unit(random) - 3),
                away = seed % 3 == 0 ? 0 : 300 * unit(random);
    const std::uint32_t most_slots = seed % 2 == 0 ? 6000 : kMaxSlots - 1;  // sparse pages
    Scene scene(1 + seed % 3);
    std::set<std::uint32_t> used;
    std::map<std::uint32_t, std::uint32_t> group_of;  // by page: another as soon as it is empty
    for (int edit = 0; edit < 12; ++edit) {
      if (unit(random) < 0.3f && !used.empty()) {
        std::vector<std::uint32_t> gone;
        for (const std::uint32_t slot : used) {
          const bool page_goes = slot / SlotPage::kSlots % 4 == std::uint32_t(edit) % 4;
          if (page_goes || unit(random) < 0.4f) gone.push_back(slot);
        }
        for (const std::uint32_t slot : gone) used.erase(slot);
        for (auto& [page, group] : group_of) {
          const auto first = used.lower_bound(page * SlotPage::kSlots);
          const bool empty = first == used.end() || *first / SlotPage::kSlots != page;
          if (empty) group = std::uint32_t(3 * unit(random));
        }
        scene.remove(gone);
      } else {
        const int count = int(3000 * std::pow(unit(random), 3.0f)) + 1;
        std::map<std::uint32_t, std::vector<std::uint32_t>> slots;  // by group
        for (int i = 0; i < count; ++i) {
          auto slot = std::uint32_t(unit(random) * float(most_slots));
          if (seed % 2 == 1) slot = slot % 50 * 600000 + slot % 40;  // of a few pages
          const std::uint32_t page = slot / SlotPage::kSlots;
          slots[group_of.emplace(page, page % 3).first->second].push_back(slot);
        }
        bool anew = edit == 6 && seed % 4 == 1;
        if (anew) used.clear();
        const auto write = [&](std::uint32_t slot) {
          used.insert(slot);
          // No opacity at the limit of 1/255, on whose other side the copy may be, once packed.
          const float size = 0.01f * spread * std::exp(4 * unit(random) - 2);
          scene.write(slot,
                      {away + spread * (unit(random) - 0.5f), spread * (unit(random) - 0.5f),
                       spread * (unit(random) - 0.5f)},
                      {size, size * unit(random), size * unit(random)},
                      unit(random) < 0.1f ? 0.001f : 0.01f + 0.99f * unit(random),
                      {unit(random), unit(random), unit(random), unit(random) + 0.1f});
        };
        for (const auto& [group, of_group] : slots) {
          scene.group = group;
          for (const std::uint32_t slot : of_group) write(slot);
          scene.send(std::exchange(anew, false) ? GaussianBatch::REPLACE : GaussianBatch::UPSERT);
        }
      }
      // It is interrupted at will, and edits go on meanwhile.
      int patience = int(6 * unit(random));
      scene.levels.advance(scene.slots, [&] { return patience-- <= 0; });
    }
    ASSERT_TRUE(scene.levels.advance(scene.slots, never));
    expectAsBuiltAtOnce(scene);
    if (HasFailure()) FAIL() << "seed " << seed;
  }
}

TEST(Levels, ASlotIsDrawnInFullUntilItsNodesStand) {
  Scene scene;
  for (std::uint32_t slot = 0; slot < 100; ++slot) {
    scene.write(slot, {0.01f * float(slot), 0, 0}, {0.01f, 0.01f, 0.01f});
  }
  scene.send();
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  scene.write(50, {9, 9, 9}, {0.01f, 0.01f, 0.01f});
  scene.send();
  EXPECT_EQ(parentsOf(scene.slots).at(50), kBoundless);
  EXPECT_LT(parentsOf(scene.slots).at(51), kBoundless);
  const auto before = nodesOf(scene.levels);
  EXPECT_FALSE(scene.levels.advance(scene.slots, [] { return true; }));
  EXPECT_TRUE(nodesOf(scene.levels) == before);
  EXPECT_EQ(parentsOf(scene.slots).at(50), kBoundless);
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  EXPECT_LT(parentsOf(scene.slots).at(50), kBoundless);
}

TEST(Levels, ManySplatsInOnePlaceAreOneNodeALevel) {
  Scene scene;
  for (std::uint32_t slot = 0; slot < 200000; ++slot)
    scene.write(slot, {1, 1, 1}, {0.01f, 0, 0}, 1);
  writeWidest(scene, 200000);
  scene.send();
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  auto nodes = nodesOf(scene.levels);
  EXPECT_EQ(nodes.erase(widestCell()), 1u);
  EXPECT_EQ(nodes.begin()->second.members.size(), 200000u);
  EXPECT_EQ(nodes.size(), std::size_t(kLevels - levelOf(nodes.begin()->first)));
  for (const auto& [cell, node] : nodes) {
    const Splat splat = unpackSlot(node.words.data());
    EXPECT_EQ(splat.position, (std::array<float, 3>{1, 1, 1}));
    EXPECT_EQ(splat.opacity, 1);  // as far as it goes
  }
}

TEST(Levels, OfAnEmptyMapAreEmpty) {
  Scene scene;
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  EXPECT_EQ(scene.levels.nodes(), 0u);
  scene.write(3, {}, {1, 1, 1});
  scene.send();
  scene.remove({3});
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  EXPECT_EQ(scene.levels.nodes(), 0u);
}

// A camera at the origin that looks along z.
PictureRequest request(const Scene& scene, double error) {
  PictureRequest request;
  PictureLayer& layer = request.layers.emplace_back();
  layer.slots = &scene.slots;
  layer.map = &scene.map.state();
  layer.camera.fx = layer.camera.fy = 200;
  layer.camera.cx = 80;
  layer.camera.cy = 60;
  layer.camera.width = 160;
  layer.camera.height = 120;
  layer.levels = &scene.levels;
  layer.error = error;
  return request;
}

Scene wall(float distance) {
  Scene scene;
  std::mt19937 random(3);
  std::uniform_real_distribution<float> unit(-1, 1);
  for (std::uint32_t slot = 0; slot < 20000; ++slot) {
    scene.write(slot, {4 * unit(random), 4 * unit(random), distance + 0.1f * unit(random)},
                {0.05f, 0.05f, 0.05f}, 0.9f);
  }
  scene.send();
  return scene;
}

TEST(Cut, LeavesNoHole) {
  Scene scene = wall(6);
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  CpuRasterizer rasterizer(std::make_shared<ThreadTeam>(1));
  SplatPicture full, picture;
  PictureRequest wanted = request(scene, 0);
  wanted.layers[0].levels = nullptr;
  rasterizer.draw(wanted, full);
  std::size_t before =
      full.layers[0].drawn + full.layers[0].drawn / 2;  // where levels blend, both are drawn
  for (double error = 1; error < 100; error *= 1.3) {
    rasterizer.draw(request(scene, error), picture);
    for (std::size_t i = 3; i < picture.colour.size(); i += 4) {
      ASSERT_GT(picture.colour[i], full.colour[i] - 0.15f) << "at " << error << " px";
    }
    before = std::min(before, picture.layers[0].drawn);
  }
  EXPECT_LT(before, full.layers[0].drawn / 20);
}

TEST(Cut, IsTheSameBesideASplatBeyondAllBounds) {
  CpuRasterizer rasterizer(std::make_shared<ThreadTeam>(1));
  SplatPicture expected, picture;
  for (const float far : {1e19f, 1e30f, 1e36f, 3.4e38f}) {
    Scene without = wall(6), with = wall(6);
    with.write(20000, {far, -far, far}, {0.05f, 0.05f, 0.05f});
    with.send();
    ASSERT_TRUE(without.levels.advance(without.slots, never));
    ASSERT_TRUE(with.levels.advance(with.slots, never));
    for (const double error : {1.0, 4.0}) {
      rasterizer.draw(request(without, error), expected);
      rasterizer.draw(request(with, error), picture);
      EXPECT_EQ(picture.colour, expected.colour) << far << " m away, at " << error << " px";
    }
  }
}

TEST(Cut, SharesOfALoneSplatAndItsNodesSumToAll) {
  Scene scene;
  scene.write(0, {0.3f, 0.1f, 6}, {0.2f, 0.1f, 0.2f}, 0.95f);
  scene.send();
  ASSERT_TRUE(scene.levels.advance(scene.slots, never));
  CpuRasterizer rasterizer(std::make_shared<ThreadTeam>(1));
  SplatPicture full, picture;
  PictureRequest wanted = request(scene, 0);
  wanted.layers[0].levels = nullptr;
  rasterizer.draw(wanted, full);
  for (double error = 1; error < 1e4; error *= 1.1) {
    rasterizer.draw(request(scene, error), picture);
    for (std::size_t i = 0; i < picture.colour.size(); ++i) {
      ASSERT_NEAR(picture.colour[i], full.colour[i], 5e-3f) << "at " << error << " px";
    }
  }
}

TEST(Levels, GroupsTakeTurns) {
  Scene scene;
  const auto write = [&](std::uint32_t group) {
    scene.group = group;
    for (std::uint32_t i = 0; i < 100; ++i) {
      scene.write(SlotPage::kSlots * group + i, {float(i), 0, 5}, {0.1f, 0.1f, 0.1f});
    }
    scene.send();
  };
  for (const std::uint32_t group : {0, 1, 2}) write(group);
  for (int i = 0; i < 4; ++i) {
    bool stands = false;
    scene.levels.advance(scene.slots, [&] { return stands; }, [&](const auto&) { stands = true; });
    write(0);
  }
  for (const std::size_t group : {0, 1, 2}) EXPECT_FALSE(nodesOf(scene.levels, group).empty());
}

// As of a map that is written anew again and again, faster than it can be merged.
TEST(LevelBuilder, BuildsHoweverMuchComesAndKeepsLittleOfIt) {
  constexpr std::uint32_t kSplats = 10'000;
  std::mt19937 random(1);
  OwnedBatch batch(1, GaussianBatch::UPSERT);
  batch.count = kSplats;
  batch.sh_degree = 3;
  fill(batch, random);
  GaussianMap map;
  BatchReport report;
  LevelBuilder builder;
  builder.apply(map.apply(batch, report), 0);  // clears, as of any new map
  const auto edit = map.apply(batch, report);
  ASSERT_FALSE(edit->clear);  // which would end what is being built
  std::unique_ptr<LevelsUpdate> update;
  std::size_t most = 0;
  const auto begin = std::chrono::steady_clock::now();
  while (!update && std::chrono::steady_clock::now() - begin < std::chrono::seconds(120)) {
    builder.apply(edit, 0);  // before it has taken the one before
    std::this_thread::sleep_for(std::chrono::microseconds(500));
    most = std::max(most, builder.bytes());
    update = builder.update(false);
  }
  ASSERT_TRUE(update);
  EXPECT_EQ(update->entries.size(), (kSplats + SlotPage::kSlots - 1) / SlotPage::kSlots);
  EXPECT_LT(most, std::size_t{64} << 20);
  builder.update(true);
  EXPECT_EQ(builder.error(), "");
}

}  // namespace
}  // namespace rosplat
