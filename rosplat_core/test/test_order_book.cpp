#include <gtest/gtest.h>

#include <memory>
#include <utility>
#include <vector>

#include "owned_batch.hpp"
#include "rosplat_core/order/order_book.hpp"
#include "rosplat_core/order/order_slots.hpp"

using namespace rosplat;

namespace {

// Splats on the camera's axis, slot i at depth depths[i].
class OrderBookTest : public testing::Test {
 protected:
  OrderBookTest() {
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
    map.apply(batch.look(), report);
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

  using Slots = std::vector<std::uint32_t>;
  SplatCamera camera;
  GaussianMap map;
  OrderBook book;
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

TEST_F(OrderBookTest, DrawsTheSidecarsOrder) {
  upsert(0, {1, 3, 2});
  book.setCamera("view", 1, camera, 0.0);
  EXPECT_FALSE(book.answered("view"));
  EXPECT_TRUE(book.offer(sidecar(1, 1, {1, 2, 0})));
  EXPECT_TRUE(book.answered("view"));
  // It never grows stale while nothing changes.
  const auto choice = book.newest("view", 100.0);
  EXPECT_EQ(choice.order->source, "sidecar");
  EXPECT_TRUE(choice.fresh);
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
  EXPECT_EQ(book.newest("view", 0.0).order, nullptr);
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
  EXPECT_EQ(book.newest("view", 0.0).order->slots, (Slots{1, 2, 0}));
  camera.translation[2] = 0.5;
  book.setCamera("view", 2, camera, 0.0);
  EXPECT_TRUE(book.offer(sidecar(2, 0, {0})));
}

TEST_F(OrderBookTest, AReceivedOrderIsOfTheMapAsItIsAndYoung) {
  book.setCamera("view", 1, camera, 0.0);
  upsert(0, {1, 2, 3});
  EXPECT_EQ(book.newest("view", 0.0).order, nullptr);
  const OrderPtr order = sidecar(1, 1, {2, 1, 0});
  ASSERT_TRUE(book.offer(order));
  EXPECT_EQ(book.newest("view", 9.0).order, order);
  EXPECT_TRUE(book.newest("view", 9.0).fresh);
  camera.translation[2] = 1;
  book.setCamera("view", 2, camera, 9.0);
  EXPECT_EQ(book.newest("view", 9.1).order, order);
  EXPECT_NEAR(book.newest("view", 9.1).age, 0.1, 1e-9);
  EXPECT_EQ(book.newest("view", 9.1 + OrderBook::kPatience).order, nullptr);
  upsert(3, {4});
  EXPECT_EQ(book.newest("view", 9.1).order, nullptr);
}
