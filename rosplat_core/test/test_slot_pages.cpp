#include <gtest/gtest.h>

#include <cstring>
#include <vector>

#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {
namespace {

GaussianEdit edit(std::vector<std::pair<std::uint32_t, std::uint32_t>> runs, float position,
                  float extent, int sh_degree = 0) {
  GaussianEdit edit;
  edit.runs = std::move(runs);
  edit.sh_degree = sh_degree;
  std::size_t slots = 0;
  for (const auto& [first, count] : edit.runs) slots += count;
  std::uint32_t word;
  std::memcpy(&word, &position, sizeof(word));
  edit.slots.assign(kSlotWords * slots, word);
  edit.extents.assign(slots, extent);
  return edit;
}

TEST(SlotPages, HaveOnePageForEachThatIsWritten) {
  SlotPages pages;
  pages.apply(edit({{5000, 1}, {kMaxSlots - 1, 1}}, 0, 1));
  pages.apply(edit({{1000, 100}}, 0, 1));  // of two pages, before the others

  std::vector<std::uint32_t> firsts, places;
  for (const SlotPage& page : pages.pages()) {
    firsts.push_back(page.first_slot);
    places.push_back(page.place);
  }
  EXPECT_EQ(firsts, (std::vector<std::uint32_t>{0, 1024, 4096, kMaxSlots - 1024}));
  EXPECT_EQ(places, (std::vector<std::uint32_t>{2, 3, 0, 1}));
  EXPECT_EQ(pages.find(1099), &pages.pages()[1]);
  EXPECT_EQ(pages.find(2048), nullptr);
  EXPECT_EQ(pages.find(kMaxSlots - 1)->place, 1u);
}

TEST(SlotPages, EmptyingSlotsNeedsNone) {
  SlotPages pages;
  pages.apply(edit({{0, 5000}}, 0, -1, -1));
  EXPECT_TRUE(pages.pages().empty());
}

TEST(SlotPages, BoundsHoldAllThatCanBeSeen) {
  SlotPages pages;
  pages.apply(edit({{0, 1}}, 2, 0.5f));
  pages.apply(edit({{0, 1}}, -3, 0.25f));
  pages.apply(edit({{1, 1}}, 100, -1));  // never to be seen
  const SlotPage& page = pages.pages().front();
  EXPECT_EQ(page.least, (std::array<float, 3>{-3, -3, -3}));
  EXPECT_EQ(page.most, (std::array<float, 3>{2, 2, 2}));
  EXPECT_EQ(page.extent, 0.5f);
}

TEST(SlotPages, APageThatGoesToAnotherGroupIsEmpty) {
  SlotPages pages;
  pages.apply(edit({{0, 2048}}, 2, 0.5f));
  GaussianEdit other = edit({{1030, 5}}, -3, 0.25f);
  other.group = 7;
  other.origin = {1, 2, 3};
  pages.apply(other);
  EXPECT_EQ(pages.emptied(), std::vector<std::uint32_t>{1024});
  const SlotPage& page = *pages.find(1030);
  EXPECT_EQ(page.place, 1u);
  EXPECT_EQ(page.most, (std::array<float, 3>{-3, -3, -3}));
  EXPECT_EQ(pages.groupOf(page).number, 7u);
  EXPECT_EQ(pages.groupOf(page).origin, other.origin);
  EXPECT_EQ(pages.groupOf(*pages.find(0)).number, 0u);
  pages.apply(other);
  EXPECT_TRUE(pages.emptied().empty());
}

TEST(SlotPages, AClearForgetsThem) {
  SlotPages pages;
  pages.apply(edit({{0, 3000}}, 0, 1));
  GaussianEdit clear = edit({{2048, 1}}, 0, 1);
  clear.clear = true;
  pages.apply(clear);
  ASSERT_EQ(pages.pages().size(), 1u);
  EXPECT_EQ(pages.pages().front().place, 0u);
}

}  // namespace
}  // namespace rosplat
