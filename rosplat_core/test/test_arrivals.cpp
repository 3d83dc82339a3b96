#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <new>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

#include "rosplat_core/map/arrivals.hpp"

namespace rosplat {
namespace {

using std::chrono::milliseconds;

void push(Arrivals& arrivals, std::uint32_t slot, bool clear = false) {
  auto edit = std::make_shared<GaussianEdit>();
  edit->clear = clear;
  edit->runs = {{slot, 1}};
  MapState state;
  state.revision = slot;
  arrivals.push(edit, state);
}

// A map that takes edits.
struct Copy {
  explicit Copy(Arrivals& arrivals) : taker(arrivals.makeTaker()) {}

  // All that waits, to where `fail` throws.
  void take(const std::function<void(std::uint32_t)>& fail = [](std::uint32_t) {}) {
    while (taker.applyNext([&](const EditQueue::Waiting& arrival) {
      const std::uint32_t slot = arrival.edit->runs.front().first;
      fail(slot);
      slots.push_back(slot);
    })) {
    }
  }

  Arrivals::Taker taker;
  std::vector<std::uint32_t> slots;
};

TEST(Arrivals, AnEditThatFailsComesFirstAgain) {
  const auto arrivals = std::make_shared<Arrivals>();
  Copy copy(*arrivals);
  arrivals->handOver(copy.taker, [] {});
  for (std::uint32_t slot = 1; slot <= 3; ++slot) push(*arrivals, slot);
  const auto failing = [](std::uint32_t slot) {
    if (slot == 2) throw std::bad_alloc();
  };
  copy.take(failing);
  EXPECT_EQ(copy.slots, (std::vector<std::uint32_t>{1}));
  EXPECT_EQ(arrivals->backlog().edits, 2u);
  EXPECT_EQ(arrivals->error(), "a part of the map isn't drawn: memory is lacking");
  EXPECT_EQ(arrivals->state().revision, 3u);

  copy.take([](std::uint32_t) { throw std::runtime_error("it is tried at once"); });
  EXPECT_EQ(arrivals->error(), "a part of the map isn't drawn: memory is lacking");
  std::this_thread::sleep_for(milliseconds(600));
  copy.take([](std::uint32_t) { throw std::runtime_error("the card is full"); });
  EXPECT_EQ(arrivals->error(), "a part of the map isn't drawn: the card is full");
  std::this_thread::sleep_for(milliseconds(600));
  copy.take();
  EXPECT_EQ(copy.slots, (std::vector<std::uint32_t>{1, 2, 3}));
  EXPECT_EQ(arrivals->error(), "");
  EXPECT_EQ(arrivals->backlog().edits, 0u);
}

TEST(Arrivals, APartThatFailsComesBeforeTheRest) {
  const auto arrivals = std::make_shared<Arrivals>();
  Copy copy(*arrivals);
  arrivals->handOver(copy.taker, [] {});
  auto edit = std::make_shared<GaussianEdit>();
  edit->clear = true;
  edit->sh_degree = 0;
  edit->runs = {{0, 5}};
  edit->slots.resize(5 * kSlotWords);
  edit->extents.resize(5);
  arrivals->push(edit, {});
  std::vector<std::pair<SlotRuns, bool>> taken;  // and whether that is the last
  bool fails = false;
  const auto take = [&] {
    return copy.taker.applyNext(
        [&](const EditQueue::Waiting& arrival) {
          if (fails) throw std::bad_alloc();
          EXPECT_EQ(arrival.edit->clear, taken.empty());
          taken.emplace_back(arrival.edit->runs, !arrival.more);
        },
        {2 * kSlotWords * sizeof(std::uint32_t), 0});
  };
  for (const bool now : {true, false, true, false, false}) {
    fails = now;
    EXPECT_EQ(take(), !fails);
    if (fails) arrivals->handOver(copy.taker, [] {});  // so that it is tried at once
  }
  const std::vector<std::pair<SlotRuns, bool>> expected{
      {{{0, 2}}, false}, {{{2, 2}}, false}, {{{4, 1}}, true}};
  EXPECT_EQ(taken, expected);
  EXPECT_EQ(arrivals->backlog().edits, 0u);
}

TEST(Arrivals, AClearNeedsNoneOfWhatFailed) {
  const auto arrivals = std::make_shared<Arrivals>();
  Copy copy(*arrivals);
  arrivals->handOver(copy.taker, [] {});
  push(*arrivals, 1);
  copy.take([&](std::uint32_t) {
    push(*arrivals, 2, true);  // meanwhile
    throw std::bad_alloc();
  });
  EXPECT_EQ(arrivals->backlog().edits, 1u);
  std::this_thread::sleep_for(milliseconds(600));
  copy.take();
  EXPECT_EQ(copy.slots, (std::vector<std::uint32_t>{2}));
}

TEST(Arrivals, WhoCannotTakeOverLeavesThemToWhoDid) {
  const auto arrivals = std::make_shared<Arrivals>();
  Copy first(*arrivals), second(*arrivals);
  arrivals->handOver(first.taker, [] {});
  push(*arrivals, 1);
  EXPECT_THROW(arrivals->handOver(second.taker, [] { throw std::bad_alloc(); }), std::bad_alloc);
  second.take();
  EXPECT_TRUE(second.slots.empty());
  first.take();
  EXPECT_EQ(first.slots, (std::vector<std::uint32_t>{1}));
}

TEST(Arrivals, NoneIsLostOrTakenTwiceWhileMapsGoOver) {
  constexpr std::uint32_t kEdits = 20000;
  const auto arrivals = std::make_shared<Arrivals>();
  std::atomic<bool> all{false}, over{false};
  std::thread publisher([&] {
    for (std::uint32_t slot = 0; slot < kEdits; ++slot) push(*arrivals, slot);
    all = true;
  });
  // Takes on, although it may have gone over to another.
  std::atomic<Copy*> newest{nullptr};
  std::vector<std::unique_ptr<Copy>> copies;
  copies.push_back(std::make_unique<Copy>(*arrivals));
  arrivals->handOver(copies.back()->taker, [] {});
  newest = copies.back().get();
  std::thread taker([&] {
    while (!over) newest.load()->take([](std::uint32_t) { std::this_thread::yield(); });
  });
  while (!all || arrivals->backlog().edits > 0) {
    copies.push_back(std::make_unique<Copy>(*arrivals));
    Copy& next = *copies.back();
    arrivals->handOver(next.taker, [&] { next.slots = copies[copies.size() - 2]->slots; });
    newest = &next;
    std::this_thread::yield();
  }
  publisher.join();
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (arrivals->backlog().edits > 0 && std::chrono::steady_clock::now() < deadline) {
    std::this_thread::yield();
  }
  over = true;
  taker.join();
  std::vector<std::uint32_t> expected;
  for (std::uint32_t slot = 0; slot < kEdits; ++slot) expected.push_back(slot);
  EXPECT_EQ(copies.back()->slots, expected);
  EXPECT_GT(copies.size(), 2u);
}

}  // namespace
}  // namespace rosplat
