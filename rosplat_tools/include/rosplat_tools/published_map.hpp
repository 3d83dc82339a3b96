#pragma once

#include <array>
#include <bitset>
#include <builtin_interfaces/msg/time.hpp>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <geometry_msgs/msg/pose.hpp>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <rosplat_msgs/msg/gaussian_array.hpp>
#include <rosplat_msgs/srv/pull_map.hpp>
#include <string>
#include <vector>

#include "rosplat_tools/splats.hpp"

namespace rosplat {

struct MapOptions {
  std::string frame_id = "map";
  std::string topic = "gaussians";      // its services are <topic>/pull and <topic>/repeat
  std::size_t chunk_bytes = 8'000'000;  // of splats in a message, at most
  std::string compression = "none";     // or "quantised", for subscribers beyond a network
};

// A living map of Gaussians: its copy by slot, and the batches that tell others of its edits. Knows
// messages, but no node: MapPublisher is it with one.
//
// Batches go out as they are made, and nobody is waited for. Who joins late, or misses some, pulls
// what has changed since the last revision that it has, as it is now. Calls are serialised, from
// any thread.
//
// What is wrong in an argument throws std::invalid_argument, which names it, and nothing is sent
// then. Where sending an edit ends by another exception, it is part of the map all the same: who
// hears the next batch pulls it.
class PublishedMap {
 public:
  using Batch = rosplat_msgs::msg::GaussianArray;
  using PullMap = rosplat_msgs::srv::PullMap;
  using Pose = geometry_msgs::msg::Pose;
  using Stamp = std::optional<builtin_interfaces::msg::Time>;  // none: now
  using Slots = std::vector<std::uint32_t>;
  using Poses = std::map<std::uint32_t, Pose>;  // by group

  // The way to those who hear of the map.
  struct Wire {
    std::function<void(std::unique_ptr<Batch>)> send;
    std::function<builtin_interfaces::msg::Time()> now;
    std::function<void(const std::string&)> warn;
  };
  // The splats of a group, in its frame, and their slots.
  struct Group {
    std::uint32_t number = 0;
    Slots slots;  // ascending
    Splats splats;
  };

  PublishedMap(MapOptions options, Wire wire);
  PublishedMap(const PublishedMap&) = delete;
  PublishedMap& operator=(const PublishedMap&) = delete;

  // Names this publisher's run.
  const std::string& mapId() const { return map_id_; }
  // Revision of the last batch that was sent, 0 before the first.
  std::uint64_t revision() const;
  // Number of slots in use.
  std::size_t size() const;
  // A copy of the map, by group.
  std::vector<Group> groups() const;
  // Where groups were placed.
  Poses poses() const;

  // Makes splats the map, in slots 0 to n - 1 and group 0; forgets where groups were placed.
  // expected_slots: how many slots the finished map will need, by default n. Where sending fails,
  // the map before stays, and is sent again.
  void replace(const Splats& splats, std::optional<std::uint32_t> expected_slots = std::nullopt,
               const Stamp& stamp = std::nullopt);
  // Sends the whole map once more, as it is: for bags, and others that only listen.
  void repeat();
  // Has the next batches say that the finished map will need so many slots, 0: who knows.
  void expect(std::uint32_t slots);
  // Writes the i-th splat to the i-th slot, or to the i-th from first_slot on, in use or not. All
  // are in one group. Slots come in blocks of GaussianArray::SLOTS_PER_BLOCK, whose splats are of
  // one group.
  void upsert(const Slots& slots, const Splats& splats, std::uint32_t group = 0,
              const Stamp& stamp = std::nullopt);
  void upsert(std::uint32_t first_slot, const Splats& splats, std::uint32_t group = 0,
              const Stamp& stamp = std::nullopt);
  // Empties slots.
  void erase(const Slots& slots, const Stamp& stamp = std::nullopt);
  void erase(std::uint32_t first_slot, std::uint32_t count, const Stamp& stamp = std::nullopt);
  // Places groups in the map's frame. One that was never placed is where the map's frame is.
  void move(const Poses& poses, const Stamp& stamp = std::nullopt);

  // What a client lacks: see PullMap.srv.
  PullMap::Response pull(const PullMap::Request& request) const;

 private:
  static constexpr std::uint32_t kPageSlots = Batch::SLOTS_PER_BLOCK;
  // Of splats in an answer to a pull: each client, idle or not, keeps room for some of the largest.
  static constexpr std::size_t kAnswerBytes = 2'000'000;

  // A block of slots of which one was written once; the arrays are as those of Splats.
  struct Page {
    std::uint32_t group = 0;
    std::bitset<kPageSlots> used;
    Splats splats;
    int sh_degree = 0;                                // of the splats
    std::array<std::uint64_t, kPageSlots> changed{};  // revision of the last change of each slot
    std::uint64_t written = 0, regrouped = 0;         // and of all of them
  };
  struct Frame {
    std::optional<std::array<double, 3>> origin;  // that the group's first splats had
    std::optional<Pose> pose;
    std::uint64_t placed = 0;  // revision
  };
  struct Content {
    std::map<std::uint32_t, Page> pages;  // by first slot / kPageSlots
    std::map<std::uint32_t, Frame> groups;
    std::vector<std::string> channels;
    std::size_t used = 0;
    int sh_degree = 0;
    bool antialiased = false;
    std::uint32_t expected_slots = 0;
  };
  // Slots of one group.
  struct Part {
    std::uint32_t group = 0;
    Slots slots;
  };
  class Numbering;

  std::size_t write(const Slots& slots, const Splats& splats, int sh_degree, std::uint32_t group,
                    std::uint64_t revision);
  void empty(Page& page, std::uint32_t at);
  void warnOf(std::size_t left_out);

  void sendMap(const Stamp& stamp);
  std::uint64_t editRevision() const;
  void sendEdit(std::unique_ptr<Batch> batch);
  void send(std::unique_ptr<Batch> batch);

  std::vector<std::uint32_t> allPages() const;
  std::vector<Part> usedOf(const std::vector<std::uint32_t>& pages, std::uint64_t since = 0) const;
  std::vector<Part> cut(Part whole, int sh_degree, std::size_t channels) const;
  static std::size_t splatBytes(int sh_degree, std::size_t channels);
  Splats gathered(const Part& part, const std::vector<std::string>& channels) const;
  Poses placedAfter(std::uint64_t revision) const;

  std::unique_ptr<Batch> batch(std::uint8_t operation, const Stamp& stamp) const;
  std::unique_ptr<Batch> beginning(const Stamp& stamp) const;
  std::unique_ptr<Batch> writing(std::uint8_t operation, const Part& part,
                                 const std::vector<std::string>& channels,
                                 const Stamp& stamp) const;
  std::unique_ptr<Batch> deletion(const Slots& slots, const Stamp& stamp) const;
  std::unique_ptr<Batch> placement(const Poses& poses, const Stamp& stamp) const;
  static void name(const Slots& slots, Batch& batch);

  const MapOptions options_;
  const Wire wire_;
  const std::string map_id_;
  mutable std::mutex mutex_;
  std::uint64_t revision_ = 0;
  std::uint64_t begun_ = 0;  // revision of the last REPLACE: older clients need all of the map
  Content map_;
};

}  // namespace rosplat
