// How the slots of an order travel from the sorter to a viewer, as rosplat_msgs/SplatOrder says:
// packed bit by bit, or through a segment of shared memory.
//
// A segment is a file in /dev/shm that holds one order at a time; SplatOrder.msg describes its
// bytes. The sorter writes segments (rosplat_sorter/shared_orders.py). Readers use read(), not
// mmap(): a file that somebody cuts short is then an error, not a SIGBUS.
//
// Functions that read slots write them into the caller's vector, which may come from SpareSlots.
// They also find the slots' bound, the least number above all slots, for a check against the map.

#pragma once

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// The most slots a map may have, rosplat_msgs/GaussianArray.MAX_SLOTS.
constexpr std::size_t kMostSlots = 1u << 25;

// The slots of an order can't be read; the text says why.
struct OrderError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A segment is of a sorter that is older or newer than the reader.
struct OtherVersionError : OrderError {
  using OrderError::OrderError;
};

// Throws OrderError for an order of more than `most` slots. To be called before allocating.
inline void checkCount(std::size_t count, std::size_t most) {
  if (count > most) {
    throw OrderError("it has " + std::to_string(count) + " slots, the map at most " +
                     std::to_string(most));
  }
}

// The size of count numbers of `bits` bits each [bytes].
constexpr std::size_t packedBytes(std::size_t count, unsigned bits) {
  return (count * bits + 7) / 8;
}

// Writes the lowest `bits` bits of each number one after the other, from the least significant bit
// of the first byte on. bits: 1 to 32. packed: packedBytes(count, bits).
inline void packSlots(const std::uint32_t* slots, std::size_t count, unsigned bits,
                      std::uint8_t* packed) {
  const std::uint64_t mask = (std::uint64_t{1} << bits) - 1;
  std::uint64_t pending = 0;
  unsigned filled = 0;
  for (std::size_t i = 0; i < count; ++i) {
    pending |= (slots[i] & mask) << filled;
    filled += bits;
    if (filled >= 32) {  // compilers make one store of these four bytes
      for (unsigned byte = 0; byte < 4; ++byte) {
        *packed++ = static_cast<std::uint8_t>(pending >> 8 * byte);
      }
      pending >>= 32;
      filled -= 32;
    }
  }
  for (; filled > 0; filled -= std::min(filled, 8u), pending >>= 8) {
    *packed++ = static_cast<std::uint8_t>(pending);
  }
}

// Keeps the memory of dropped orders for new ones: memory pages that are new to a process take
// several times as long as filling them. For any thread.
class SpareSlots {
 public:
  // Returns the largest kept memory, with its contents; an empty vector if none is kept.
  std::vector<std::uint32_t> reuse() {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto largest = std::max_element(
        kept_.begin(), kept_.end(),
        [](const auto& one, const auto& other) { return one.capacity() < other.capacity(); });
    return std::exchange(*largest, {});
  }
  // Drops memory of which the order used less than an eighth, lest that of a former map stays.
  void giveBack(std::vector<std::uint32_t>&& slots) noexcept {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (slots.size() < slots.capacity() / 8) return;
    for (std::vector<std::uint32_t>& kept : kept_) {
      if (kept.capacity() == 0) return kept.swap(slots);
    }
  }

 private:
  static constexpr std::size_t kMost = 3;  // one order drawn, one that waits, one being read

  std::mutex mutex_;
  std::array<std::vector<std::uint32_t>, kMost> kept_;
};

// Returns the bound of slots: the highest plus 1, or 0.
inline std::size_t boundOf(const std::uint32_t* slots, std::size_t count) {
  if (count == 0) return 0;
  std::array<std::uint32_t, 8> highest{};  // side by side, to vectorise
  std::size_t i = 0;
  for (; i + highest.size() <= count; i += highest.size()) {
    for (std::size_t lane = 0; lane < highest.size(); ++lane) {
      highest[lane] = std::max(highest[lane], slots[i + lane]);
    }
  }
  for (; i < count; ++i) highest[0] = std::max(highest[0], slots[i]);
  return std::size_t{*std::max_element(highest.begin(), highest.end())} + 1;
}

// Undoes packSlots(); returns the slots' bound. Throws OrderError where bits or size don't fit.
inline std::size_t unpackSlots(const std::uint8_t* packed, std::size_t size, std::size_t count,
                               unsigned bits, std::vector<std::uint32_t>& slots) {
  if (bits < 1 || bits > 32) {
    throw OrderError("slot_bits is " + std::to_string(bits) + ", not 1 to 32");
  }
  checkCount(count, kMostSlots);
  if (size != packedBytes(count, bits)) {
    throw OrderError("packed has " + std::to_string(size) + " bytes, which are not " +
                     std::to_string(count) + " slots of " + std::to_string(bits) + " bits");
  }
  const std::uint64_t mask = (std::uint64_t{1} << bits) - 1;
  const std::uint8_t* const end = packed + size;
  slots.resize(count);
  std::uint64_t pending = 0;
  unsigned filled = 0;
  std::uint32_t highest = 0;
  for (std::uint32_t& slot : slots) {
    if (filled < bits && end - packed >= 4) {  // compilers make one load of these four bytes
      const std::uint32_t next = packed[0] | std::uint32_t{packed[1]} << 8 |
                                 std::uint32_t{packed[2]} << 16 | std::uint32_t{packed[3]} << 24;
      pending |= std::uint64_t{next} << filled;
      packed += 4;
      filled += 32;
    }
    for (; filled < bits; filled += 8) pending |= std::uint64_t{*packed++} << filled;
    slot = static_cast<std::uint32_t>(pending & mask);
    highest = std::max(highest, slot);
    pending >>= bits;
    filled -= bits;
  }
  return count == 0 ? 0 : std::size_t{highest} + 1;
}

// The beginning of a segment.
struct SegmentHeader {
  static constexpr std::array<char, 8> kMagic = {'R', 'O', 'S', 'P', 'L', 'A', 'T', '\0'};
  static constexpr std::uint32_t kVersion = 1;
  static constexpr std::size_t kBytes = 4096;  // a memory page: the slots begin at the next
  static constexpr const char* kFolder = "/dev/shm/";
  static constexpr const char* kPrefix = "rosplat_order_";

  std::array<char, 8> magic = kMagic;
  std::uint32_t version = kVersion;
  std::uint32_t zero = 0;
  std::uint64_t key = 0;
  std::uint64_t generation = 0;
};

// Marks a segment's contents. The writer marks an odd generation before touching the slots, and the
// next even one after. header: where the segment is mapped.
inline void markSegment(void* header, std::uint64_t generation) {
  auto* mark = reinterpret_cast<std::atomic<std::uint64_t>*>(static_cast<char*>(header) +
                                                             offsetof(SegmentHeader, generation));
  static_assert(sizeof(*mark) == sizeof(generation));
  std::atomic_thread_fence(std::memory_order_seq_cst);  // mark after earlier writes of slots
  mark->store(generation, std::memory_order_relaxed);
  std::atomic_thread_fence(std::memory_order_seq_cst);  // mark before later writes of slots
}

// A segment to read from, open as long as the reader lives.
class SegmentReader {
 public:
  // Throws OrderError if the name isn't a segment's, or this process can't read the segment.
  explicit SegmentReader(const std::string& name) : name_(name) {
    const std::size_t prefix = std::strlen(SegmentHeader::kPrefix);
    if (name.compare(0, prefix, SegmentHeader::kPrefix) != 0 || name.size() > prefix + 64 ||
        !std::all_of(name.begin(), name.end(), [](char c) {
          return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
        })) {
      throw OrderError("segment is not the name of one");
    }
    // Whatever has this name: open() follows no link, and doesn't wait (for a pipe's writer).
    file_ = ::open((SegmentHeader::kFolder + name).c_str(),
                   O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    struct stat status;
    if (file_ < 0) throw OrderError(complaint("can't be opened"));
    const bool regular = ::fstat(file_, &status) == 0 && S_ISREG(status.st_mode);
    const SegmentHeader found = regular ? header() : SegmentHeader();
    if (found.version != SegmentHeader::kVersion || found.key == 0) {
      ::close(file_);
      if (found.version == SegmentHeader::kVersion) {
        throw OrderError(complaint("is not one of a sorter"));
      }
      throw OtherVersionError(complaint("is of version " + std::to_string(found.version) +
                                        ", and " + std::to_string(SegmentHeader::kVersion) +
                                        " is known: orders come in messages"));
    }
  }
  ~SegmentReader() { ::close(file_); }
  SegmentReader(const SegmentReader&) = delete;
  SegmentReader& operator=(const SegmentReader&) = delete;

  std::uint64_t key() const { return header().key; }

  // Reads the count slots of a generation; returns their bound. Throws OrderError if the segment
  // holds another generation.
  std::size_t read(std::size_t count, std::uint64_t generation, std::vector<std::uint32_t>& slots,
                   ThreadTeam& team) const {
    struct stat status;
    checkCount(count, kMostSlots);
    const std::size_t bytes = count * sizeof(std::uint32_t);
    if (::fstat(file_, &status) != 0 ||
        static_cast<std::size_t>(status.st_size) < SegmentHeader::kBytes + bytes) {
      throw OrderError(complaint("does not hold " + std::to_string(count) + " slots"));
    }
    if (generation % 2 != 0 || header().generation != generation) {
      throw OrderError(complaint("holds another order"));
    }
    slots.resize(count);
    constexpr std::size_t kShare = 1u << 17;  // slots worth waking a thread for
    std::vector<std::size_t> bounds(std::clamp<std::size_t>(count / kShare, 1, team.size()));
    std::atomic<bool> complete{true};
    team.run(static_cast<unsigned>(bounds.size()), [&](unsigned share, unsigned) {
      const std::size_t begin = count * share / bounds.size();
      const std::size_t end = count * (share + 1) / bounds.size();
      if (!readSlots(begin, end, slots.data(), bounds[share])) complete = false;
    });
    std::atomic_thread_fence(std::memory_order_acquire);  // read the mark after the slots
    if (!complete || header().generation != generation) {
      throw OrderError(complaint("was overwritten while it was read"));
    }
    return *std::max_element(bounds.begin(), bounds.end());
  }

 private:
  std::string complaint(const std::string& what) const { return "segment " + name_ + " " + what; }

  // Returns a header with key 0 if the segment's can't be read.
  SegmentHeader header() const {
    SegmentHeader header;
    const bool complete = readBytes(&header, sizeof(header), 0);
    return complete && header.magic == SegmentHeader::kMagic ? header : SegmentHeader();
  }

  // Reads the slots [begin, end) to slots + begin, and finds their bound. Returns false on failure.
  bool readSlots(std::size_t begin, std::size_t end, std::uint32_t* slots,
                 std::size_t& bound) const {
    constexpr std::size_t kPart = 1u << 14;  // slots that stay in the cache until boundOf()
    for (std::size_t first = begin; first < end; first += kPart) {
      const std::size_t size = std::min(kPart, end - first);
      if (!readBytes(slots + first, size * sizeof(std::uint32_t),
                     SegmentHeader::kBytes + first * sizeof(std::uint32_t))) {
        return false;
      }
      bound = std::max(bound, boundOf(slots + first, size));
    }
    return true;
  }

  bool readBytes(void* target, std::size_t size, std::size_t offset) const {
    auto* bytes = static_cast<char*>(target);
    while (size > 0) {
      const ssize_t got = ::pread(file_, bytes, size, static_cast<off_t>(offset));
      if (got <= 0) return false;
      bytes += got;
      offset += static_cast<std::size_t>(got);
      size -= static_cast<std::size_t>(got);
    }
    return true;
  }

  std::string name_;
  int file_;
};

// The viewer's side: reads the slots of its orders, and the key that proves to the sorter that the
// viewer can read the sorter's segments. One thread reads; any thread may call key().
class OrderReader {
 public:
  // As in SplatOrder.
  enum Encoding : std::uint8_t { kSlots, kPacked, kShared };

  // Reads the slots of an order in an encoding other than kSlots; arguments as in SplatOrder.
  // Returns the slots' bound. Throws OrderError, also for more than `most` slots; the contents of
  // `slots` are undefined then.
  std::size_t read(std::uint8_t encoding, const std::uint8_t* packed, std::size_t packed_size,
                   std::size_t count, unsigned slot_bits, const std::string& segment,
                   std::uint64_t generation, std::vector<std::uint32_t>& slots,
                   std::size_t most = kMostSlots) {
    checkCount(count, most);
    if (encoding == kPacked) {
      learnKey(segment);
      if (slot_bits < 32) checkCount(count, std::size_t{1} << slot_bits);  // each slot once
      return unpackSlots(packed, packed_size, count, slot_bits, slots);
    }
    if (encoding != kShared) {
      throw OrderError("encoding " + std::to_string(encoding) + " is unknown");
    }
    const SegmentReader reader = open(segment);
    key_ = reader.key();
    return reader.read(count, generation, slots, *team_);
  }

  // For ViewCamera.segment_key; 0 while no segment can be read.
  std::uint64_t key() const { return key_; }

  // Returns, once, why orders come in messages despite segments; else empty. Reading thread only.
  std::string takeRemark() { return std::exchange(remark_, {}); }

 private:
  // Opens a segment. On failure sets the key to 0, which asks for orders in messages.
  SegmentReader open(const std::string& segment) {
    try {
      return SegmentReader(segment);
    } catch (const OrderError&) {
      key_ = 0;
      throw;
    }
  }

  void learnKey(const std::string& segment) {
    try {
      key_ = segment.empty() ? 0 : open(segment).key();
    } catch (const OtherVersionError& error) {
      if (!std::exchange(remarked_, true)) remark_ = error.what();
    } catch (const OrderError&) {  // the segment is of another machine, container or user
    }
  }

  std::atomic<std::uint64_t> key_{0};
  bool remarked_ = false;
  std::string remark_;
  std::shared_ptr<ThreadTeam> team_ = ThreadTeam::ofViewers();
};

}  // namespace rosplat
