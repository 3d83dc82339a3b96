#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "map/named_slots.hpp"
#include "map/page_splats.hpp"
#include "rosplat_core/map/published_map.hpp"
#include "rosplat_core/map/slot_revisions.hpp"

namespace rosplat {

// What a published map holds by slot, and the revision of each change. Sends nothing, locks
// nothing.
class PublishedContent {
 public:
  using Slots = PublishedMap::Slots;
  using Poses = PublishedMap::Poses;

  // How splats are to be written.
  struct Plan {
    int sh_degree = 0;                  // without empty bands, which packed splats keep
    std::vector<std::string> channels;  // that the map will have
    std::vector<std::size_t> places;    // in `channels`, of the splats' channels
  };

  // Of an answer to a pull.
  struct Limits {
    std::size_t bytes;
    int sh_degree;
  };
  // What has changed since a revision. At least one block of it, whatever the limits.
  struct Changes {
    Poses poses;
    Slots emptied;
    std::map<std::uint32_t, Slots> written;  // by group
    std::uint32_t next_block = 0;            // 0: that was all
  };

  PublishedContent() = default;
  // Packed splats, which stay in their keeper's memory, in slots from 0 on.
  PublishedContent(const SplatsView& splats, const std::shared_ptr<const void>& keeper);

  std::size_t used() const { return used_; }
  int shDegree() const { return sh_degree_; }
  Model model() const { return model_.value_or(Model::kEwa); }
  const std::vector<std::string>& channels() const { return channels_; }
  // Size of a splat in a message. listed: with the slot's number. [bytes]
  static std::size_t splatBytes(int sh_degree, std::size_t channel_count, bool listed);

  // --- Edits ---
  // Each is checked, and its memory allocated, by a call of its own before.
  // If a check throws std::invalid_argument, the map is unchanged; if std::bad_alloc, new pages
  // stay, but empty ones do no harm. revision: of the edit's last batch.

  // The lowest free slots of a group's pages, then those of pages that no splat uses. Throws
  // std::invalid_argument where the map has no room.
  Slots freeSlots(std::size_t count, std::uint32_t group) const;
  Plan prepareWrite(const NamedSlots& slots, const SplatsView& splats, std::uint32_t group);
  // Writes the i-th splat to the i-th slot. Returns how many are invalid and left out.
  std::size_t write(const NamedSlots& slots, const SplatsView& splats, const Plan& plan,
                    std::uint32_t group, std::uint64_t revision);
  void prepareErase(const NamedSlots& slots);
  void erase(const NamedSlots& slots, std::uint64_t revision);
  void preparePlace(const Poses& poses);
  void place(const Poses& poses, std::uint64_t revision);

  // --- Reading, of slots whose pages exist ---

  std::vector<PublishedMap::Group> groups() const;
  Poses placedAfter(std::uint64_t revision) const;
  // Fills arrays with the splats of slots.
  void read(const NamedSlots& slots, int sh_degree, Splats& splats) const;
  // The packed rows of slots.
  std::vector<std::uint8_t> readRows(const NamedSlots& slots, int sh_degree) const;
  // The slots' values of some of the map's channels, channel by channel.
  std::vector<float> readChannels(const NamedSlots& slots,
                                  const std::vector<std::string>& channels) const;
  // The origin of a group's splats.
  std::array<double, 3> originOf(std::uint32_t group) const;
  // What has changed after a revision, from first_block on; after revision 0: everything.
  Changes changes(std::uint64_t after, std::uint32_t first_block, const Limits& limits) const;

  // --- Sending all ---

  // Begins to send all: returns the blocks that have splats, by group.
  std::map<std::uint32_t, std::vector<std::uint32_t>> beginSending();
  bool holds(std::uint32_t slot, std::uint32_t group) const;
  // Takes slots for changed.
  void touch(const NamedSlots& slots, std::uint64_t revision);

 private:
  // A block of slots, at least one of which was ever written.
  struct Page {
    std::uint32_t group = 0;
    std::bitset<kPageSlots> used;
    PageSplats splats;
    SlotRevisions changed{kPageSlots};         // of each slot
    std::uint64_t written = 0, regrouped = 0;  // revisions: any slot's last change, the group's
  };
  struct Frame {
    std::optional<std::array<double, 3>> origin;  // of the group's first splats
    std::optional<Pose> pose;
    std::uint64_t placed = 0;  // revision of the last move
  };
  struct BlockChanges {
    Poses placed;
    Slots emptied, written;
    std::uint32_t group = 0;
  };

  std::optional<std::uint32_t> blockFrom(std::uint32_t first) const;
  BlockChanges changesOf(std::uint32_t block, std::uint64_t after, const Poses& known) const;
  template <typename Each>
  void forEach(const NamedSlots& slots, const Each& each) const;

  std::map<std::uint32_t, Page> pages_;  // by first slot / kPageSlots
  std::map<std::uint32_t, Frame> groups_;
  std::vector<std::string> channels_;
  std::size_t used_ = 0;
  int sh_degree_ = 0;
  std::optional<Model> model_;  // as the first splats
};

}  // namespace rosplat
