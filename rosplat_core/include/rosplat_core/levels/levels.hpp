#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "rosplat_core/levels/lattice.hpp"
#include "rosplat_core/levels/mixture.hpp"
#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// One Gaussian for all that is in a cell.
struct Node {
  Cell cell;
  PackedSlot packed;                   // as Mixture::pack() has it
  float extent;                        // as nodeExtentOf()
  std::vector<std::uint32_t> members;  // slots that enter the lattice here, ascending
};

// Some nodes of a level, neighbours in space, with the corners of their cells and of their
// parents'.
struct NodeSamples {
  static constexpr std::size_t kCount = 16;
  template <typename T>
  using Each = std::array<T, kCount>;

  std::array<Each<float>, 3> position, corner, parent_corner;  // [m]
  Each<float> extent;                                          // less than 0: there is none
  Each<float> nodes, members;  // that each stands for: all of the level do for some
};
// Of each level of a group, spread evenly over its nodes, side by side in memory: what a view shows
// of large maps is estimated by these alone.
using LevelSamples = std::array<std::vector<NodeSamples>, kLevels>;

// Nodes of one level, neighbours in space. Never changed, once it is filled.
class NodePage {
 public:
  NodePage(int sh_degree, std::uint32_t group);
  // In the order of their cells.
  void add(Cell cell, const PackedSlot& packed, const std::uint32_t* members, std::size_t count);
  SlotPage bounds;          // as if the nodes were slots
  HostSlots::Page slots{};  // the nodes, in the order of their cells
  std::vector<Cell> cells;

  int level() const { return levelOf(cells.front()); }
  Node node(std::size_t i, int sh_degree) const;
  // Of a node: from where, and how many.
  std::pair<const std::uint32_t*, std::size_t> membersOf(std::size_t i) const;
  // Of all nodes before one, which may be the end.
  std::size_t membersBefore(std::size_t i) const { return i > 0 ? ends_[i - 1] : 0; }
  std::size_t bytes() const;

 private:
  int sh_degree_;
  std::vector<std::uint32_t> members_, ends_;  // those of one node after the other
};

// Levels of detail, merged from a map group by group, in the group's frame, so that they move with
// it: a node for each cell of the lattice that holds anything, of the nodes in that cell and the
// slots that enter there. An edit has the cells that it touches, and those around them, made anew
// from all that is in them, in a fixed order: so the nodes are to the bit those of a map that was
// there at once. What they don't hold yet has no parent, and is drawn in full. For one thread at a
// time, with the help of a team.
class Levels {
 public:
  using Pages = std::vector<std::shared_ptr<const NodePage>>;  // by their cells
  using Nodes = std::array<Pages, kLevels>;

  explicit Levels(std::shared_ptr<ThreadTeam> team) : team_(std::move(team)) {}

  // Slots were written, or emptied.
  void mark(const HostSlots& slots, const SlotRuns& runs);
  // The map is another.
  void clear();

  // Works on what is marked, the first time on all, until `stop` says so, which is asked every few
  // milliseconds; whether nothing is left. The nodes are those of before until all of the new ones
  // stand, of which `stand` is told: of slots in which pages, by the first. Throws std::bad_alloc,
  // and goes on from there the next time.
  bool advance(HostSlots& slots, const std::function<bool()>& stop,
               const std::function<void(const std::vector<std::uint32_t>&)>& stand = nullptr);

  const std::vector<Nodes>& groups() const { return nodes_; }  // by index, as far as there are any
  const std::vector<LevelSamples>& samples() const { return samples_; }  // of them
  std::size_t nodes() const;
  std::size_t bytes() const;

 private:
  // A slot that enters a cell, or is there anew; or that leaves it.
  struct Change {
    Cell cell;
    std::uint32_t slot;
    bool enters;
  };
  // By cell, then slot.
  struct Changes {
    std::unique_ptr<Change[]> all;
    std::size_t count = 0;

    const Change* begin() const { return all.get(); }
    const Change* end() const { return all.get() + count; }
  };
  // What is known of a page of slots.
  struct Known {
    std::uint32_t group;                       // whose nodes hold it, or soon will
    std::array<Cell, SlotPage::kSlots> cells;  // in which they do
    std::bitset<SlotPage::kSlots> marked;
  };
  // A range of a level's cells.
  struct Piece {
    Cell begin, end;
    std::vector<Cell> touched;
    Pages pages;                // what it becomes
    std::vector<Cell> parents;  // of what is touched
  };
  // Nodes of some touched cells.
  struct Made {
    std::vector<Cell> cells;
    std::vector<PackedSlot> packed;
    std::vector<std::uint32_t> members, ends;  // those of one node after the other
  };
  // The way from what was marked of a group to nodes that hold it, level by level.
  struct Job {
    std::uint32_t group;
    std::vector<std::uint32_t> marked;  // first slots of pages
    Changes changes;
    Nodes pages;
    int level = -1;  // that is being made
    std::vector<Piece> pieces;
    std::vector<std::size_t> touched;  // of them: the others are what they were
    std::size_t done = 0;              // of these
  };

  void begin(const HostSlots& slots);
  void findChanges(const HostSlots& slots, const SlotPage& page,
                   std::vector<Change>& changes) const;
  Changes sorted(const std::vector<std::vector<Change>>& parts) const;
  static Cell cellOf(const Known& known, const SlotPage& of, const HostSlots::Page& page,
                     std::uint32_t i);
  void know(const HostSlots& slots, const SlotPage& page);
  void nextLevel();
  void cut(int level, std::vector<Cell> touched, std::vector<Piece>& pieces,
           std::vector<std::size_t>& touched_pieces) const;
  void make(const HostSlots& slots, std::size_t count);
  Made nodesOf(const HostSlots& slots, const Piece& piece, std::size_t begin,
               std::size_t end) const;
  void fill(Piece& piece, const std::vector<Made>& made, int sh_degree) const;
  void publish(HostSlots& slots) const;
  LevelSamples sampled(const Nodes& nodes) const;

  std::shared_ptr<ThreadTeam> team_;
  bool begun_ = false;
  std::vector<std::unique_ptr<Known>> known_;                   // by place
  std::map<std::uint32_t, std::vector<std::uint32_t>> marked_;  // first slots of pages, by group
  std::uint32_t next_group_ = 0;                                // groups take turns
  std::unique_ptr<Job> job_;
  std::vector<Nodes> nodes_;           // by group
  std::vector<LevelSamples> samples_;  // of these
};

}  // namespace rosplat
