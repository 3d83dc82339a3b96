#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/packed_slot.hpp"
#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// The slots of a map in the processor's memory, page by page: 40 bytes a slot and those of its
// further bands, 4 for each channel, and 4 where there are levels. Not for several threads at once,
// but any number may read.
class HostSlots {
 public:
  static constexpr std::size_t kSlots = SlotPage::kSlots;
  template <typename T>
  using PerSlot = std::array<T, kSlots>;

  // The numbers that decide whether a slot may be seen lie apart from those that say what it looks
  // like: most of a map is out of sight.
  struct alignas(64) Page {
    std::array<PerSlot<float>, 3> position;       // [m]
    PerSlot<float> extent;                        // as in GaussianEdit
    std::array<PerSlot<std::uint32_t>, 6> words;  // 3 to 8 of a packed slot
    std::array<std::unique_ptr<std::uint32_t[]>, kMaxShDegree + 1>
        bands;  // coefficient by coefficient, kSlots of each; null where there are none
    std::array<std::unique_ptr<PerSlot<float>>, kMostChannels> channels;  // null: no values
    // How wide the cells are whose nodes stand for each slot where they are small in a picture:
    // kBoundless where there is none, 0 of empty slots. Null where there are none for the page. [m]
    std::unique_ptr<PerSlot<float>> parents;
    float widest_parent = kBoundless;  // of any slot [m]

    void empty();
    // Of a packed slot, without its bands.
    std::uint32_t word(std::size_t k, std::size_t i) const {
      if (k >= position.size()) return words[k - position.size()][i];
      std::uint32_t bits;
      std::memcpy(&bits, &position[k][i], sizeof(bits));
      return bits;
    }
    PackedSlot packed(std::size_t i, int sh_degree) const;
    // All slots' words of a band, or, of 0, the others: slot by slot, as they are packed.
    void interleave(int band, std::uint32_t* to) const;
    // Of all but the extent.
    void put(std::size_t i, const PackedSlot& slot, int sh_degree);
  };

  // now: the clock of `change` in packed_slot.hpp; team: helps. Throws std::bad_alloc: then all is
  // as it was, but for a clear, which gives its memory to what comes.
  void apply(const GaussianEdit& edit, double now, ThreadTeam* team = nullptr);

  const std::vector<SlotPage>& pages() const { return pages_.pages(); }  // by ascending first_slot
  const Page& at(const SlotPage& page) const { return *memory_[page.place]; }
  Page& at(const SlotPage& page) { return *memory_[page.place]; }
  const SlotPages& index() const { return pages_; }
  int shDegree() const { return sh_degree_; }
  std::size_t bytes() const;

  // The values of slots as they are drawn.
  std::vector<SplatValues> read(const std::vector<std::uint32_t>& slots) const;
  // What writes a page elsewhere.
  GaussianEdit edit(const SlotPage& page) const;
  // Sets the widths of the cells whose nodes stand for a page's slots; a width below 0 leaves the
  // one before. Only maps with levels need this and its memory, which makeParents() makes.
  void setParents(const SlotPage& page, const PerSlot<float>& sizes);
  void makeParents(const SlotPage& page);
  // There are no nodes any more.
  void dropParents();

 private:
  // Slots of one page.
  struct PageWrite {
    std::uint32_t first, count;
    std::size_t source;  // in the edit
  };
  void makeRoom(const GaussianEdit& edit, Page& page) const;
  void write(const GaussianEdit& edit, const PageWrite& part, std::uint32_t change);
  void writeChannels(const GaussianEdit& edit, std::size_t source, Page& page, std::size_t target,
                     std::size_t count);

  SlotPages pages_;
  std::vector<std::unique_ptr<Page>> memory_;  // by place
  int sh_degree_ = 0;
  std::size_t channels_ = 0;  // that there are values of
};

}  // namespace rosplat
