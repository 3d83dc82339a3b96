#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/packed_slot.hpp"
#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// The slots of a map in the processor's memory, page by page: 40 bytes a slot and those of its
// further bands, 4 for each channel, and 4 where there are levels. For one thread that writes, or
// any number that read.
class HostSlots {
 public:
  static constexpr std::size_t kSlots = SlotPage::kSlots;
  template <typename T>
  using PerSlot = std::array<T, kSlots>;

  // The numbers that decide whether a slot may be seen lie apart from its appearance: most of a map
  // is out of sight. The former are read for slot after slot. Appearances are read for the few
  // slots of a page that are seen at one depth, so each is a row of neighbouring words.
  struct alignas(64) Page {
    std::array<PerSlot<float>, 3> position;        // [m]
    PerSlot<float> extent;                         // as in GaussianEdit
    int sh_degree = -1;                            // of the appearances; -1: there are none
    std::unique_ptr<std::uint32_t[]> appearances;  // kSlots rows of appearanceWords(sh_degree)
    std::array<std::unique_ptr<PerSlot<float>>, kMostChannels> channels;  // null: no values
    // Width of the cell whose node stands for each slot when that cell is small in a picture:
    // kBoundless without a node, 0 of empty slots. Null before makeParents(). [m]
    std::unique_ptr<PerSlot<float>> parents;
    float widest_parent = kBoundless;  // no slot has a wider one [m]

    // Makes room for the bands of a degree; a page never loses any.
    void reserve(int degree);
    void empty();
    const std::uint32_t* appearance(std::size_t i) const {
      return &appearances[appearanceWords(sh_degree) * i];
    }
    std::uint32_t* appearance(std::size_t i) {
      return &appearances[appearanceWords(sh_degree) * i];
    }
    // Word k of the i-th slot as packed_slot.hpp has it.
    std::uint32_t word(std::size_t k, std::size_t i) const {
      if (k >= kFirstAppearanceWord) return appearance(i)[k - kFirstAppearanceWord];
      std::uint32_t bits;
      std::memcpy(&bits, &position[k][i], sizeof(bits));
      return bits;
    }
    PackedSlot packed(std::size_t i, int degree) const;
    // Writes all slots' words of a band (0: all kSlotWords), slot by slot as in GaussianEdit.
    void interleave(int band, std::uint32_t* to) const;
    // Writes a slot, except its extent.
    void put(std::size_t i, const PackedSlot& slot, int degree);
    std::size_t appearanceBytes() const;
  };

  // now: time for `change` in packed_slot.hpp [ticks]; team: threads that help. Throws
  // std::bad_alloc: then nothing has changed, but a clear has emptied the map to free its memory.
  void apply(const GaussianEdit& edit, double now, ThreadTeam* team = nullptr);

  const std::vector<SlotPage>& pages() const { return pages_.pages(); }  // by ascending first_slot
  const Page& at(const SlotPage& page) const { return *memory_[page.place]; }
  Page& at(const SlotPage& page) { return *memory_[page.place]; }
  const SlotPages& index() const { return pages_; }
  int shDegree() const { return sh_degree_; }
  std::size_t bytes() const;

  // The values of slots as they are drawn.
  std::vector<SplatValues> read(const std::vector<std::uint32_t>& slots) const;
  // An edit that writes a page to another copy of the map.
  GaussianEdit edit(const SlotPage& page) const;
  // Sets Page::parents; a size below 0 leaves the slot's previous one. Only maps with levels need
  // this memory, which makeParents() allocates.
  void setParents(const SlotPage& page, const PerSlot<float>& sizes);
  void makeParents(const SlotPage& page);
  // Frees all parents: there are no nodes any more.
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
  std::size_t channels_ = 0;  // one past the last that has values
};

}  // namespace rosplat
