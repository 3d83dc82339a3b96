#include <gtest/gtest.h>
#include <sys/mman.h>

#include <algorithm>
#include <atomic>
#include <numeric>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rosplat_core/order/order_slots.hpp"

namespace rosplat {
namespace {

using Slots = std::vector<std::uint32_t>;

std::size_t plainBound(const Slots& slots) {
  return slots.empty() ? 0 : *std::max_element(slots.begin(), slots.end()) + std::size_t{1};
}

// A segment of a sorter's, written by hand.
class SegmentTest : public testing::Test {
 protected:
  static constexpr std::size_t kCapacity = 300000;  // that threads share
  static constexpr std::uint64_t kKey = 77;

  void SetUp() override {
    path = SegmentHeader::kFolder + name;
    const int file = ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL, 0600);
    ASSERT_GE(file, 0);
    const std::size_t size = SegmentHeader::kBytes + kCapacity * sizeof(std::uint32_t);
    ASSERT_EQ(::ftruncate(file, static_cast<off_t>(size)), 0);
    memory = static_cast<char*>(::mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0));
    ASSERT_NE(memory, MAP_FAILED);
    ::close(file);
    SegmentHeader header;
    header.key = kKey;
    std::memcpy(memory, &header, sizeof(header));
    slots = reinterpret_cast<std::uint32_t*>(memory + SegmentHeader::kBytes);
  }
  void TearDown() override {
    ::munmap(memory, SegmentHeader::kBytes + kCapacity * sizeof(std::uint32_t));
    ::unlink(path.c_str());
  }

  Slots read(std::size_t count, std::uint64_t generation) {
    Slots found;
    const std::size_t bound =
        reader.read(OrderReader::kShared, nullptr, 0, count, 0, name, generation, found);
    EXPECT_EQ(found.size(), count);
    EXPECT_EQ(bound, plainBound(found));
    return found;
  }

  const std::string name =
      SegmentHeader::kPrefix + std::string("test_") + std::to_string(::getpid());
  std::string path;
  char* memory = nullptr;
  std::uint32_t* slots = nullptr;
  OrderReader reader;
};

TEST(PackedSlots, AreBitsFromTheLeastSignificantOn) {
  const Slots slots = {0b101, 0b010, 0b111, 0b001};
  std::uint8_t packed[2];
  packSlots(slots.data(), slots.size(), 3, packed);
  EXPECT_EQ(packed[0], 0b11010101);
  EXPECT_EQ(packed[1], 0b00000011);
}

TEST(PackedSlots, ComeBackAtAnyWidth) {
  std::mt19937 random(1);
  for (unsigned bits = 1; bits <= 32; ++bits) {
    for (const std::size_t count : {0, 1, 2, 7, 8, 9, 1001}) {
      Slots slots(count);
      for (auto& slot : slots) slot = static_cast<std::uint32_t>(random() >> (32 - bits));
      std::vector<std::uint8_t> packed(packedBytes(count, bits));
      packSlots(slots.data(), count, bits, packed.data());
      Slots unpacked(5, 77);  // of an order before
      EXPECT_EQ(unpackSlots(packed.data(), packed.size(), count, bits, unpacked),
                plainBound(slots));
      EXPECT_EQ(unpacked, slots) << bits;
    }
  }
}

TEST(PackedSlots, OfAnotherSizeAreRefused) {
  const std::uint8_t packed[8] = {};
  Slots slots;
  EXPECT_EQ(unpackSlots(packed, 8, 3, 20, slots), 1u);
  EXPECT_EQ(slots, Slots(3, 0));
  EXPECT_THROW(unpackSlots(packed, 7, 3, 20, slots), OrderError);
  EXPECT_THROW(unpackSlots(packed, 8, 4, 20, slots), OrderError);
  EXPECT_THROW(unpackSlots(packed, 0, 1, 0, slots), OrderError);
  EXPECT_THROW(unpackSlots(packed, 5, 1, 40, slots), OrderError);
  const std::size_t overflowing = std::size_t{1} << 62;  // times 32 is 0
  EXPECT_THROW(unpackSlots(packed, 0, overflowing, 32, slots), OrderError);
  // No more slots than numbers of so many bits: 4 MB would be 33 million instances.
  const std::vector<std::uint8_t> bits(4u << 20, 0xff);
  Slots none;
  OrderReader reader;
  EXPECT_THROW(
      reader.read(OrderReader::kPacked, bits.data(), bits.size(), 1u << 25, 1, "", 0, none),
      OrderError);
  EXPECT_THROW(reader.read(OrderReader::kPacked, packed, 8, 3, 20, "", 0, none, 2), OrderError);
  EXPECT_EQ(none.capacity(), 0u);
}

TEST_F(SegmentTest, HoldsTheOrderOfItsGeneration) {
  markSegment(memory, 1);
  std::copy_n(Slots{3, 1, 2}.data(), 3, slots);
  markSegment(memory, 2);
  EXPECT_EQ(read(3, 2), (Slots{3, 1, 2}));
  EXPECT_EQ(reader.key(), kKey);
  EXPECT_EQ(read(0, 2), Slots{});
  markSegment(memory, 3);
  EXPECT_THROW(read(3, 2), OrderError);  // the next is being written
  EXPECT_THROW(read(3, 3), OrderError);
  markSegment(memory, 4);
  EXPECT_THROW(read(3, 2), OrderError);
  EXPECT_EQ(read(3, 4).size(), 3u);
  EXPECT_THROW(read(kCapacity + 1, 4), OrderError);
  EXPECT_THROW(read(~std::size_t{0} / 4, 4), OrderError);
  EXPECT_EQ(reader.key(), kKey);  // the segment is there all the same
}

TEST_F(SegmentTest, IsReadWithItsBoundIntoMemoryThatIsThere) {
  Slots found(kCapacity);
  const std::uint32_t* const memory_before = found.data();
  for (const std::size_t count : {kCapacity, std::size_t{16384}, std::size_t{16385}}) {
    std::iota(slots, slots + count, 0u);
    for (const std::size_t highest : {std::size_t{0}, count / 2, count - 1}) {
      markSegment(memory, 2);
      const std::uint32_t before = std::exchange(slots[highest], 0xffffffffu);
      EXPECT_EQ(reader.read(OrderReader::kShared, nullptr, 0, count, 0, name, 2, found),
                std::size_t{1} << 32);
      EXPECT_TRUE(std::equal(found.begin(), found.end(), slots, slots + count));
      EXPECT_EQ(found.data(), memory_before);
      slots[highest] = before;
    }
  }
}

TEST_F(SegmentTest, IsNeverReadWhileItChanges) {
  std::atomic<bool> stop{false};
  std::thread writer([&] {
    for (std::uint64_t generation = 2; !stop; generation += 2) {
      markSegment(memory, generation - 1);
      std::fill_n(slots, kCapacity, static_cast<std::uint32_t>(generation));
      markSegment(memory, generation);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  int complete = 0, dropped = 0;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
  while ((complete < 20 || dropped < 20) && std::chrono::steady_clock::now() < deadline) {
    std::uint64_t generation;
    std::memcpy(&generation, memory + offsetof(SegmentHeader, generation), sizeof(generation));
    try {
      const Slots found = read(kCapacity, generation);
      ASSERT_EQ(found, Slots(kCapacity, static_cast<std::uint32_t>(generation)));
      ++complete;
    } catch (const OrderError&) {
      ++dropped;
    }
  }
  stop = true;
  writer.join();
  EXPECT_GE(complete, 20);
  EXPECT_GE(dropped, 20);
}

TEST_F(SegmentTest, CutShortIsRefused) {
  markSegment(memory, 2);
  ASSERT_EQ(::truncate(path.c_str(), SegmentHeader::kBytes + 8), 0);
  EXPECT_EQ(read(2, 2).size(), 2u);
  EXPECT_THROW(read(3, 2), OrderError);
  ASSERT_EQ(::truncate(path.c_str(), 10), 0);
  EXPECT_THROW(read(0, 2), OrderError);
  EXPECT_EQ(reader.key(), 0u);
}

TEST_F(SegmentTest, OfAnotherKindIsRefused) {
  markSegment(memory, 2);
  const std::string link = name + "_link", pipe = name + "_pipe", folder = name + "_folder";
  const auto at = [](const std::string& entry) { return SegmentHeader::kFolder + entry; };
  ASSERT_EQ(::symlink(path.c_str(), at(link).c_str()), 0);
  ASSERT_EQ(::mkfifo(at(pipe).c_str(), 0600), 0);
  ASSERT_EQ(::mkdir(at(folder).c_str(), 0700), 0);
  for (const std::string& bad :
       {link, pipe, folder, name + "_missing", std::string(), std::string("../etc/passwd"),
        name + "/../" + name, std::string(SegmentHeader::kPrefix) + "../x",
        std::string(SegmentHeader::kPrefix) + std::string(1 << 20, 'a'),
        std::string("fastrtps_port7001"), name + std::string(1, '\0') + "x"}) {
    Slots found;
    EXPECT_THROW(reader.read(OrderReader::kShared, nullptr, 0, 1, 0, bad, 2, found), OrderError)
        << bad;
    EXPECT_EQ(reader.key(), 0u);
  }
  ::unlink(at(link).c_str());
  ::unlink(at(pipe).c_str());
  ::rmdir(at(folder).c_str());
  memory[0] = 'X';
  EXPECT_THROW(read(1, 2), OrderError);
}

TEST_F(SegmentTest, OfAnotherVersionIsRefusedAndThatIsSaidOnce) {
  const std::uint32_t version = 2;
  std::memcpy(memory + offsetof(SegmentHeader, version), &version, sizeof(version));
  markSegment(memory, 2);
  const std::vector<std::uint8_t> packed = {0b01'10'00};
  const std::string said =
      "segment " + name + " is of version 2, and 1 is known: orders come in messages";
  for (const std::string& remark : {said, std::string()}) {
    Slots found;
    reader.read(OrderReader::kPacked, packed.data(), 1, 3, 2, name, 0, found);
    EXPECT_EQ(found, (Slots{0, 2, 1}));
    EXPECT_EQ(reader.key(), 0u);
    EXPECT_EQ(reader.takeRemark(), remark);
  }
  EXPECT_THROW(read(3, 2), OrderError);
}

TEST_F(SegmentTest, KeyComesWithPackedOrdersToo) {
  const std::uint8_t packed[3] = {1, 2, 3};
  Slots found;
  const auto unpack = [&](const std::string& segment) {
    reader.read(OrderReader::kPacked, packed, 3, 3, 8, segment, 0, found);
    return found;
  };
  EXPECT_EQ(unpack(name), (Slots{1, 2, 3}));
  EXPECT_EQ(reader.key(), kKey);
  EXPECT_EQ(unpack("rosplat_order_of_another_machine"), (Slots{1, 2, 3}));
  EXPECT_EQ(reader.key(), 0u);
  EXPECT_EQ(unpack(""), (Slots{1, 2, 3}));
  EXPECT_EQ(reader.key(), 0u);
  EXPECT_THROW(reader.read(9, packed, 3, 3, 8, name, 0, found), OrderError);
}

}  // namespace
}  // namespace rosplat
