#include <gtest/gtest.h>

#include <string>

#include "../src/display/fair_queue.hpp"

namespace rosplat {

using Queue = FairQueue<std::string, int>;

TEST(FairQueue, ServesOneClientInTheOrderOfItsRequests) {
  Queue queue(4);
  for (int i : {1, 2, 3}) EXPECT_FALSE(queue.push("a", i));
  for (int i : {1, 2, 3}) EXPECT_EQ(queue.pop(), i);
  EXPECT_TRUE(queue.empty());
  EXPECT_FALSE(queue.pop());
}

TEST(FairQueue, ClientsTakeTurns) {
  Queue queue(8);
  for (int i : {1, 2, 3}) queue.push("flood", i);
  queue.push("a", 10);
  queue.push("b", 20);
  queue.push("b", 21);
  for (int i : {1, 10, 20, 2, 21, 3}) EXPECT_EQ(queue.pop(), i);
}

TEST(FairQueue, RefusesWhoeverHasAskedMost) {
  Queue queue(3);
  for (int i : {1, 2, 3}) EXPECT_FALSE(queue.push("flood", i));
  EXPECT_EQ(queue.push("flood", 4), 4);
  EXPECT_EQ(queue.push("a", 10), 3);
  EXPECT_EQ(queue.push("flood", 5), 5);  // it has 2 of 3 already
  for (int i : {1, 10, 2}) EXPECT_EQ(queue.pop(), i);
}

TEST(FairQueue, RefusesTheLatestWhereAllHaveAskedAsMuch) {
  Queue queue(2);
  queue.push("a", 1);
  queue.push("b", 2);
  EXPECT_EQ(queue.push("c", 3), 3);
  for (int i : {1, 2}) EXPECT_EQ(queue.pop(), i);
}

}  // namespace rosplat
