#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "owned_batch.hpp"
#include "rosplat_core/order/order_book.hpp"
#include "rosplat_core/order/order_slots.hpp"

using namespace rosplat;

namespace {

// Splats on the camera's axis, slot i at depth depths[i].
class OrderBookTest : public testing::Test {
 protected:
  OrderBookTest() : book(sorter) {
    camera.fx = camera.fy = 100;
    camera.cx = camera.cy = 50;
    camera.width = camera.height = 100;
  }

  // The map's next batch, or that revision once more; the first replaces the map.
  void upsert(std::uint32_t first, const std::vector<float>& depths, std::uint64_t revision = 0,
              const std::vector<std::uint32_t>& listed = {}) {
    if (revision == 0) revision = map.state().revision + 1;
    OwnedBatch batch(revision, revision == 1 ? GaussianBatch::REPLACE : GaussianBatch::UPSERT,
                     first);
    batch.slot_list = listed;
    for (float depth : depths) batch.add({0, 0, depth}, {0.01f, 0.01f, 0.01f}, 1);
    BatchReport report;
    const auto edit = map.apply(batch.look(), report);
    sorter.apply(EditQueue::node(edit, map.state()));
    book.mapChanged(map.state());
  }

  OrderPtr sidecar(std::uint64_t sequence, std::uint64_t revision,
                   std::vector<std::uint32_t> slots) {
    auto order = std::make_shared<Order>();
    order->view_id = "view";
    order->sequence = sequence;
    order->map_id = "map";
    order->revision = revision;
    order->source = "sidecar";
    order->bound = boundOf(slots.data(), slots.size());
    order->slots = std::move(slots);
    return order;
  }

  // Asks until the sorting thread has answered, for a bounded time.
  template <typename Ask>
  OrderBook::Choice until(const std::string& source, Ask ask) {
    for (int i = 0; i < 2000; ++i) {
      const OrderBook::Choice choice = ask();
      if (choice.order && choice.order->source == source) return choice;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return {};
  }
  OrderBook::Choice builtIn() {
    return until("built-in", [this] { return book.builtIn("view", 0.0); });
  }

  using Slots = std::vector<std::uint32_t>;
  SplatCamera camera;
  GaussianMap map;
  OrderPool pool;
  BuiltInSorter sorter{pool};
  OrderBook book;
};

// The address space that this process may have, as it was once this ends.
class MemoryLimit {
 public:
  explicit MemoryLimit(rlim_t more) {
    getrlimit(RLIMIT_AS, &before_);
    std::size_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    const rlimit limit{pages * rlim_t(sysconf(_SC_PAGESIZE)) + more, before_.rlim_max};
    setrlimit(RLIMIT_AS, &limit);
  }
  ~MemoryLimit() { setrlimit(RLIMIT_AS, &before_); }

 private:
  rlimit before_{};
};

}  // namespace

TEST(OrderPool, MakesOrdersInTheMemoryOfThoseThatAreForgotten) {
  OrderPool pool;
  auto kept = pool.make(), dropped = pool.make();
  kept->slots.assign(1000, 1);
  dropped->slots.assign(1000, 2);
  const std::uint32_t* const memory = dropped->slots.data();
  dropped.reset();
  auto again = pool.make();
  again->slots.resize(1000);
  EXPECT_EQ(again->slots.data(), memory);
  EXPECT_EQ(kept->slots, std::vector<std::uint32_t>(1000, 1));
}

TEST(OrderPool, MayEndBeforeItsOrders) {
  std::shared_ptr<Order> order;
  {
    OrderPool pool;
    order = pool.make();
  }
  order->slots.assign(1000, 1);
  EXPECT_EQ(order.use_count(), 1);
}

TEST_F(OrderBookTest, SortsItself) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  const auto choice = builtIn();
  ASSERT_TRUE(choice.order);
  EXPECT_EQ(choice.order->slots, (Slots{1, 2, 0}));
  EXPECT_TRUE(choice.fresh);
  EXPECT_EQ(choice.age, 0.0);
}

TEST_F(OrderBookTest, DrawsTheSidecarsOrder) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  EXPECT_FALSE(book.answered("view"));
  EXPECT_TRUE(book.offer(sidecar(1, 1, {1, 2, 0})));
  EXPECT_TRUE(book.answered("view"));
  // It never grows stale while nothing changes.
  const auto choice = book.fromSidecar("view", 100.0);
  EXPECT_EQ(choice.order->source, "sidecar");
  EXPECT_TRUE(choice.fresh);
}

TEST_F(OrderBookTest, TheOrderOfASilentSidecarGrowsOld) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  EXPECT_FALSE(book.fromSidecar("view", 0.0).order);
  book.offer(sidecar(1, 1, {1, 2, 0}));
  camera.translation = {0, 0, 1};
  book.setCamera("view", 2, camera, 10.0);
  const auto choice = book.fromSidecar("view", 10.1);
  EXPECT_EQ(choice.order->source, "sidecar");
  EXPECT_FALSE(choice.fresh);
  EXPECT_NEAR(choice.age, 0.1, 1e-9);
}

// A merge compares the depths of one camera.
TEST_F(OrderBookTest, SortsAllWhereTheCameraOfTheSidecarsOrderIsForgotten) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  book.offer(sidecar(1, 1, {1, 2, 0}));
  for (std::uint64_t sequence = 2; sequence < 200; ++sequence) {
    camera.translation = {0, 0, 1e-3 * double(sequence)};
    book.setCamera("view", sequence, camera, 0.0);
  }
  upsert(1, {0.5f});
  const auto choice = until("built-in", [this] { return book.fromSidecar("view", 0.2); });
  ASSERT_TRUE(choice.order);
  EXPECT_EQ(choice.order->slots, (Slots{2, 0, 1}));
  EXPECT_EQ(choice.order->sequence, 199u);
}

TEST_F(OrderBookTest, ChangedSlotsAreMergedIntoTheSidecarsOrder) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  book.offer(sidecar(1, 1, {1, 2, 0}));
  upsert(3, {2.5f, 5.0f});  // revision 2: two new ones
  upsert(1, {0.5f});        // revision 3: the farthest moved to the front
  const auto choice = until("sidecar + built-in", [this] { return book.fromSidecar("view", 0.2); });
  ASSERT_TRUE(choice.order);
  EXPECT_EQ(choice.order->slots, (Slots{4, 3, 2, 0, 1}));
  EXPECT_EQ(choice.order->revision, 3u);
}

TEST_F(OrderBookTest, AnOrderAheadOfTheMapWaitsForIt) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  EXPECT_TRUE(book.offer(sidecar(1, 2, {1, 3, 2, 0})));
  EXPECT_FALSE(book.answered("view"));
  upsert(3, {2.5f});
  EXPECT_TRUE(book.answered("view"));
}

TEST_F(OrderBookTest, OrdersOfTheTimeBeforeAreForgottenWhenTheMapIsPlayedOnceMore) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  book.offer(sidecar(1, 1, {1, 2, 0}));
  upsert(0, {3, 1}, 1);
  EXPECT_FALSE(book.answered("view"));
  const auto choice = builtIn();
  ASSERT_TRUE(choice.order);
  EXPECT_EQ(choice.order->slots, (Slots{0, 1}));
  // Not from its beginning: what has changed since an order is not known any more.
  upsert(2, {2});
  upsert(2, {4});
  upsert(1, {5}, 2);
  book.offer(sidecar(1, 1, {0, 1}));
  const auto back = builtIn();
  ASSERT_TRUE(back.order);
  EXPECT_EQ(back.order->slots, (Slots{1, 2, 0}));
}

TEST_F(OrderBookTest, RefusesOrdersThatFitNothing) {
  upsert(0, {1, 3, 2});
  EXPECT_FALSE(book.offer(sidecar(1, 1, {0})));  // no such view yet
  book.setCamera("view", 5, camera, 0.0);
  EXPECT_FALSE(book.offer(sidecar(6, 1, {0})));           // of a camera never sent
  EXPECT_FALSE(book.offer(sidecar(5, 1, {0, 3})));        // a slot beyond the map
  EXPECT_FALSE(book.offer(sidecar(5, 1, {0, 1, 1, 2})));  // more than the map has
  EXPECT_TRUE(book.offer(sidecar(5, 1, {0, 2})));
  EXPECT_FALSE(book.offer(sidecar(4, 1, {0})));  // older than the one that is here
}

TEST_F(OrderBookTest, AnOrderOfNoRevisionReplacesNoneThatIsFresh) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  ASSERT_TRUE(book.offer(sidecar(1, 0, {0})));
  EXPECT_FALSE(book.answered("view"));
  ASSERT_TRUE(book.offer(sidecar(1, 1, {1, 2, 0})));
  EXPECT_FALSE(book.offer(sidecar(1, 0, {0})));
  EXPECT_TRUE(book.answered("view"));
  EXPECT_EQ(book.fromSidecar("view", 0.0).order->slots, (Slots{1, 2, 0}));
  camera.translation[2] = 0.5;
  book.setCamera("view", 2, camera, 0.0);
  EXPECT_TRUE(book.offer(sidecar(2, 0, {0})));
}

TEST_F(OrderBookTest, SortNowMatchesTheDepthsExactly) {
  std::vector<float> depths;
  for (int i = 0; i < 5000; ++i) depths.push_back(1.0f + float((i * 7919) % 1000));  // with ties
  upsert(0, depths);
  book.setCamera("view", 1, camera, 0.0);
  Slots expected(depths.size());
  for (std::uint32_t i = 0; i < expected.size(); ++i) expected[i] = i;
  std::stable_sort(expected.begin(), expected.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return depths[a] < depths[b]; });
  std::reverse(expected.begin(), expected.end());
  EXPECT_EQ(book.sortNow("view").order->slots, expected);
}

// While a sort for the same camera is in progress.
TEST_F(OrderBookTest, SortNowKnowsTheLastEdit) {
  const std::vector<float> depths(200'000, 2.0f);
  upsert(0, depths);
  book.setCamera("view", 1, camera, 0.0);
  for (int i = 0; i < 20; ++i) {
    book.builtIn("view", 0.0);
    std::this_thread::sleep_for(std::chrono::milliseconds(i % 5));
    upsert(0, {1}, 0, {std::uint32_t(i)});
    EXPECT_EQ(book.sortNow("view").order->revision, map.state().revision);
  }
}

TEST(BuiltInSorter, IsFedAnewAfterAFeedThatFailed) {
  OrderPool pool;
  GaussianMap map;
  int feeds = 0;
  BuiltInSorter* fed = nullptr;
  BuiltInSorter sorter(pool, [&] {
    OwnedBatch batch(map.state().revision + 1, GaussianBatch::REPLACE, 0);
    for (int i = 0; i < 3; ++i) batch.add({0, 0, 2 + float(i)}, {0.1f, 0.1f, 0.1f}, 1);
    BatchReport report;
    const auto edit = map.apply(batch.look(), report);
    if (++feeds == 1) throw std::bad_alloc();
    fed->apply(EditQueue::node(edit, map.state()));
  });
  fed = &sorter;
  SplatCamera camera;
  camera.fx = camera.fy = camera.cx = camera.cy = 50;
  camera.width = camera.height = 100;
  EXPECT_THROW(sorter.sortNow("view", 1, camera), std::bad_alloc);
  EXPECT_EQ(sorter.sortNow("view", 1, camera)->slots.size(), 3u);
}

TEST_F(OrderBookTest, SlotsFarApartCostTheirPagesUntilAReplace) {
  book.setCamera("view", 1, camera, 0.0);
  Slots slots;  // as keyframe << 16 | i
  for (std::uint32_t keyframe = 0; keyframe < 512; ++keyframe) slots.push_back(keyframe << 16);
  std::vector<float> depths;
  for (std::size_t i = 0; i < slots.size(); ++i) depths.push_back(float(1 + i % 7));
  upsert(0, depths, 0, slots);
  Slots expected = slots;
  std::stable_sort(expected.begin(), expected.end(),
                   [](std::uint32_t a, std::uint32_t b) { return (a >> 16) % 7 < (b >> 16) % 7; });
  std::reverse(expected.begin(), expected.end());
  EXPECT_EQ(book.sortNow("view").order->slots, expected);
  EXPECT_LT(sorter.bytes(), 16u << 20);
  upsert(0, {1}, 1);
  EXPECT_EQ(book.sortNow("view").order->slots, Slots{0});
  EXPECT_LT(sorter.bytes(), 64u << 10);
}

TEST_F(OrderBookTest, AReceivedOrderIsOfTheMapAsItIsAndYoung) {
  book.setCamera("view", 1, camera, 0.0);
  upsert(0, {1, 2, 3});
  EXPECT_EQ(book.received("view", 0.0).order, nullptr);
  const OrderPtr order = sidecar(1, 1, {2, 1, 0});
  ASSERT_TRUE(book.offer(order));
  EXPECT_EQ(book.received("view", 9.0).order, order);
  EXPECT_TRUE(book.received("view", 9.0).fresh);
  camera.translation[2] = 1;
  book.setCamera("view", 2, camera, 9.0);
  EXPECT_EQ(book.received("view", 9.1).order, order);
  EXPECT_NEAR(book.received("view", 9.1).age, 0.1, 1e-9);
  EXPECT_EQ(book.received("view", 9.1 + OrderBook::kPatience).order, nullptr);
  upsert(3, {4});
  EXPECT_EQ(book.received("view", 9.1).order, nullptr);
}

// However many edits lie between, and whatever they do.
TEST_F(OrderBookTest, AMergedOrderIsThatOfAll) {
  std::mt19937 random(1);
  const auto upTo = [&](std::uint32_t end) {
    return std::uniform_int_distribution<std::uint32_t>(0, end)(random);
  };
  const auto write = [&](std::uint32_t count) {
    Slots slots;
    std::vector<float> depths;
    for (std::uint32_t i = 0; i < count; ++i) {
      slots.push_back(upTo(3) * 100000 + upTo(400));
      depths.push_back(float(upTo(99)) - 3);  // with ties, some behind the camera
    }
    upsert(0, depths, 0, slots);
  };
  for (int round = 0; round < 20; ++round) {
    write(300);
    book.setCamera("view", std::uint64_t(round) + 1, camera, 0.0);
    auto base = std::make_shared<Order>(*book.sortNow("view").order);
    base->source = "sidecar " + std::to_string(round);
    ASSERT_TRUE(book.offer(base));
    for (std::uint32_t edits = upTo(300); edits > 0; --edits) write(upTo(3));
    write(1);
    const auto merged =
        until(base->source + " + built-in", [this] { return book.fromSidecar("view", 0.0); });
    ASSERT_TRUE(merged.order);
    EXPECT_EQ(merged.order->slots, book.sortNow("view").order->slots);
  }
}

TEST_F(OrderBookTest, aMapThatNoMemoryIsThereForIsSortedByNobody) {
  book.setCamera("view", 1, camera, 0.0);
  upsert(0, {1, 2});
  {
    const MemoryLimit limit(200u << 20);
    Slots slots;  // each in a page of its own: 490 MB
    for (std::uint32_t page = 0; page < 20000; ++page) slots.push_back(page * 1024);
    upsert(0, std::vector<float>(slots.size(), 3), 0, slots);
    const OrderBook::Choice choice = book.sortNow("view");
    EXPECT_TRUE(choice.order->slots.empty());
    EXPECT_EQ(choice.order->source, "built-in (out of memory)");
  }
}
