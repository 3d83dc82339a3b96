#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/slots/splats.hpp"

namespace rosplat {

class NamedSlots;
class PublishedContent;

// A message's time; made from a builtin_interfaces Time or an rclcpp::Time.
struct Stamp {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;

  Stamp() = default;
  Stamp(std::int32_t sec, std::uint32_t nanosec) : sec(sec), nanosec(nanosec) {}
  template <typename Time, typename = decltype(std::declval<Time>().nanosec)>
  Stamp(const Time& time) : Stamp(time.sec, time.nanosec) {}
  template <typename Time, typename = decltype(std::declval<Time>().nanoseconds()), typename = void>
  Stamp(const Time& time)
      : Stamp(static_cast<std::int32_t>(time.nanoseconds() / 1'000'000'000),
              static_cast<std::uint32_t>(time.nanoseconds() % 1'000'000'000)) {}
};

// The publisher's side of a map: keeps a copy of it by slot, packed as displays hold it, and makes
// the batches that tell receivers of edits.
//
// A batch is sent as soon as it is made; the publisher waits for nobody. A receiver that joins late
// or misses batches pulls what has changed since its last revision. Calls may come from any thread
// and run one after another; pulls and getters don't wait while a map is being sent.
//
// A wrong argument throws std::invalid_argument, which names it, and sends nothing. If sending
// throws anything else, the edit stays part of the map: receivers of the next batch pull it.
class PublishedMap {
 public:
  using Slots = std::vector<std::uint32_t>;
  using Poses = std::map<std::uint32_t, Pose>;  // by group
  using When = std::optional<Stamp>;            // none: now

  // A batch to send. Its payload and slots take at most chunk_bytes, or the bytes of one splat;
  // those of a MOVE 60 bytes a group.
  struct Batch : BatchHead {
    When stamp;
    Slots slots;
    Poses poses;
    std::vector<std::uint8_t> payload;
    std::vector<float> channels;
  };
  // How batches are sent.
  struct Wire {
    std::function<void(Batch&&)> send;
    std::function<void(const std::string&)> warn;
    // Returns once all subscribers have what was sent, or once waiting for them is given up.
    std::function<void()> settle;
  };
  // The splats of a group, in its frame, and their slots.
  struct Group {
    std::uint32_t number = 0;
    std::optional<Pose> pose;  // where it was placed
    Slots slots;               // ascending
    Splats splats;
  };
  // The answer to a pull: see PullMap.srv.
  struct Answer {
    std::vector<Batch> batches;
    std::uint32_t next_block = 0;
  };

  // chunk_bytes: the most bytes of a batch's arrays. compression: "none" sends packed rows;
  // "quantised" is for subscribers across a network. Throws std::invalid_argument for any other
  // value.
  PublishedMap(std::size_t chunk_bytes, const std::string& compression, Wire wire);
  ~PublishedMap();
  PublishedMap(const PublishedMap&) = delete;
  PublishedMap& operator=(const PublishedMap&) = delete;

  // Identifies this run of the publisher.
  const std::string& mapId() const { return map_id_; }
  // Revision of the last batch that was sent, 0 before the first.
  std::uint64_t revision() const;
  // Number of slots in use.
  std::size_t size() const;
  // A copy of the map, by group.
  std::vector<Group> groups() const;
  // Where groups were placed.
  Poses poses() const;
  // The splats that a group has in slots, as an UPSERT would send them.
  Batch copy(const Slots& slots, std::uint32_t group) const;

  // Replaces the map by splats, in slots 0 to n - 1 and group 0, and forgets the poses of groups.
  // expected: as of expect(), by default n without the splats that are left out. If sending fails,
  // the previous map stays and is sent again.
  void replace(const Splats& splats, std::optional<std::uint32_t> expected = std::nullopt,
               const When& stamp = std::nullopt);
  // keeper: owner of packed splats that the map is to use in place; they must not change then.
  void replace(const SplatsView& splats, const std::shared_ptr<const void>& keeper,
               std::optional<std::uint32_t> expected, const When& stamp);
  // Sends the whole map again, for listeners that can't pull, such as a recorder. Waits after each
  // batch until the subscribers have it. Other threads may edit the map meanwhile.
  void repeat();
  // Announces, from the next batch on, how many slots the finished map will need, 0 if unknown.
  void expect(std::uint32_t slots);
  // Writes the i-th splat to the i-th slot, or to the i-th from first_slot on, in use or not. All
  // are in one group. Slots come in blocks of GaussianArray::SLOTS_PER_BLOCK, whose splats are of
  // one group.
  void upsert(const Slots& slots, const Splats& splats, std::uint32_t group = 0,
              const When& stamp = std::nullopt);
  void upsert(std::uint32_t first_slot, const Splats& splats, std::uint32_t group = 0,
              const When& stamp = std::nullopt);
  void upsert(const Slots& slots, const SplatsView& splats, std::uint32_t group, const When& stamp);
  void upsert(std::uint32_t first_slot, const SplatsView& splats, std::uint32_t group,
              const When& stamp);
  // Writes splats to free slots of a group's blocks, or of blocks that no splat uses; returns the
  // slots, ascending. Throws std::invalid_argument where the map has no room.
  Slots append(const Splats& splats, std::uint32_t group = 0, const When& stamp = std::nullopt);
  Slots append(const SplatsView& splats, std::uint32_t group, const When& stamp);
  // Empties slots.
  void erase(const Slots& slots, const When& stamp = std::nullopt);
  void erase(std::uint32_t first_slot, std::uint32_t count, const When& stamp = std::nullopt);
  // Places groups in the map's frame. A group that was never placed is at the identity.
  void move(const Poses& poses, const When& stamp = std::nullopt);

  // Returns what a client lacks that holds all of after_revision, from first_block on. map_id: the
  // client's map, empty if it knows none. Harmonics above most_sh_degree are left out. An answer
  // takes 2 MB at most. It is empty if map_id names another map, and before the first batch.
  Answer pull(const std::string& map_id, std::uint64_t after_revision, std::uint32_t first_block,
              int most_sh_degree) const;

 private:
  class Numbering;
  using Lock = std::unique_lock<std::recursive_mutex>;

  void upsert(const NamedSlots& slots, const SplatsView& splats, std::uint32_t group,
              const When& stamp);
  void erase(const NamedSlots& slots, const When& stamp);
  void warnOf(std::size_t left_out);

  void sendMap(Lock& turn, Lock& lock, const When& stamp, bool waits);
  void sendSplats(Lock& turn, Lock& lock, const When& stamp, bool waits);
  std::size_t beginnings() const;
  void begin(Lock& lock, const When& stamp);
  void send(Lock& lock, Batch&& batch);

  Batch batch(std::uint8_t operation, const When& stamp) const;
  Batch beginning(const When& stamp) const;
  Batch writing(std::uint8_t operation, const NamedSlots& slots, std::uint32_t group, int sh_degree,
                const std::vector<std::string>& channels, const When& stamp) const;
  bool quantise(const NamedSlots& slots, Batch& batch) const;
  Batch deletion(const NamedSlots& slots, const When& stamp) const;
  Batch placement(Poses poses, const When& stamp) const;

  const std::size_t chunk_bytes_;
  const std::string compression_;
  const Wire wire_;
  const std::string map_id_;
  // Recursive: Wire::send may ask for the map's size.
  std::recursive_mutex turns_;          // held to edit and send; locked before mutex_
  mutable std::recursive_mutex mutex_;  // guards the map; free for pulls while a map is being sent
  std::uint64_t revision_ = 0;
  std::uint64_t begun_ = 0;  // revision of the last REPLACE: older clients need all of the map
  std::uint32_t expected_ = 0;
  std::unique_ptr<PublishedContent> map_;
};

}  // namespace rosplat
