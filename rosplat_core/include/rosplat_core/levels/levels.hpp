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

// A node of a level: one Gaussian in place of all that is in a cell.
struct Node {
  Cell cell;
  PackedSlot packed;                   // as Mixture::pack() returns it
  float extent;                        // as nodeExtentOf()
  std::vector<std::uint32_t> members;  // slots that enter the lattice here, ascending
};

// Sampled nodes of a level, neighbours in space, with the corners of their cells and of their
// parents' cells.
struct NodeSamples {
  static constexpr std::size_t kCount = 16;
  template <typename T>
  using Each = std::array<T, kCount>;

  std::array<Each<float>, 3> position, corner, parent_corner;  // [m]
  Each<float> extent;                                          // less than 0: no sample
  Each<float> nodes, members;  // how many each sample stands for; they sum to all of the level
};
// By level of a group: samples spread evenly over the level's nodes. A CutEstimate reads nothing
// else, for maps are large.
using LevelSamples = std::array<std::vector<NodeSamples>, kLevels>;

// Nodes of one level, neighbours in space. Immutable once it is filled.
class NodePage {
 public:
  NodePage(int sh_degree, std::uint32_t group);
  // Adds a node; cells must ascend from call to call.
  void add(Cell cell, const PackedSlot& packed, const std::uint32_t* members, std::size_t count);
  SlotPage bounds;          // as if the nodes were slots
  HostSlots::Page slots{};  // the nodes, by ascending cells
  std::vector<Cell> cells;

  int level() const { return levelOf(cells.front()); }
  Node node(std::size_t i, int sh_degree) const;
  // A node's members: where they begin, and how many there are.
  std::pair<const std::uint32_t*, std::size_t> membersOf(std::size_t i) const;
  // How many members all nodes before node i have; i may be one past the last.
  std::size_t membersBefore(std::size_t i) const { return i > 0 ? ends_[i - 1] : 0; }
  std::size_t bytes() const;

 private:
  int sh_degree_;
  std::vector<std::uint32_t> members_, ends_;  // by node; ends_[i]: where node i's end in members_
};

// Levels of detail, merged from a map group by group, in the group's frame, so that they move with
// the group. Each cell of the lattice that holds anything has a node, merged from the child nodes
// in that cell and the slots that enter there. A group's levels end at the first one of at most
// kFewestNodes nodes after which no slot enters. After an edit, the cells that it touches and all
// cells around those are merged again from everything in them, in a fixed order: the nodes equal,
// to the bit, those of a map that was built at once. A slot that no node holds yet has no parent
// and is drawn in full. For one thread at a time, with the help of a team.
class Levels {
 public:
  using Pages = std::vector<std::shared_ptr<const NodePage>>;  // by ascending cells
  using Nodes = std::array<Pages, kLevels>;
  static constexpr std::size_t kFewestNodes = 8;  // as many as there are octants

  explicit Levels(std::shared_ptr<ThreadTeam> team) : team_(std::move(team)) {}

  // Tells of slots that an edit has just written or emptied.
  void mark(const HostSlots& slots, const SlotRuns& runs);
  // Forgets all nodes: the map is another.
  void clear();

  // Merges the marked slots, the first time all slots, until `stop` returns true; calls `stop`
  // every few milliseconds. Returns whether nothing is left to do. A group keeps its old nodes
  // until all of its new ones stand; then calls `stand` with the first slots of the pages that had
  // marked slots. Throws std::bad_alloc; the next call goes on from there.
  bool advance(HostSlots& slots, const std::function<bool()>& stop,
               const std::function<void(const std::vector<std::uint32_t>&)>& stand = nullptr);

  const std::vector<Nodes>& groups() const { return nodes_; }  // by index; further groups have none
  const std::vector<LevelSamples>& samples() const { return samples_; }  // the same
  std::size_t nodes() const;
  // Whether there is memory to free with clear().
  bool begun() const { return begun_; }
  std::size_t bytes() const;

 private:
  // A slot that enters a cell, or was written again in it (enters), or that leaves it.
  struct Change {
    Cell cell;
    std::uint32_t slot;
    bool enters;
  };
  // By cell, then slot.
  struct Changes {
    std::unique_ptr<Change[]> all;
    std::size_t count = 0;
    std::vector<Cell> cells;  // of all, each once

    const Change* begin() const { return all.get(); }
    const Change* end() const { return all.get() + count; }
  };
  // What the nodes hold of a page of slots.
  struct Known {
    std::uint32_t group;                       // whose nodes hold it, or soon will: its index
    std::array<Cell, SlotPage::kSlots> cells;  // at which each slot entered; kNoCell: none
    std::bitset<SlotPage::kSlots> marked;
  };
  using Entering = std::array<std::int64_t, kLevels>;  // how many slots enter, by level
  // What a part of the marked pages changes.
  struct FoundChanges {
    std::vector<Change> all;
    Entering more{};  // negative: fewer
  };
  // A range of a level's cells, begin to end.
  struct Piece {
    Cell begin, end;
    const Cell *touched, *touched_end;  // its touched cells, in Job::cells
    Pages pages;                        // its new ones
    std::vector<Cell> parents;          // of touched cells

    std::size_t count() const { return std::size_t(touched_end - touched); }
  };
  // Nodes of some touched cells.
  struct Made {
    std::vector<Cell> cells;
    std::vector<PackedSlot> packed;
    std::vector<std::uint32_t> members, ends;  // as NodePage's
  };
  // Work on the nodes of one group that had marked slots, level by level.
  struct Job {
    std::uint32_t group;
    std::vector<std::uint32_t> marked;  // first slots of pages
    Changes changes;
    Entering entering;
    Nodes pages;
    int level = -1;           // being made; -1 before the first
    std::vector<Cell> cells;  // of the level, that are touched
    std::vector<Piece> pieces;
    std::vector<std::size_t> touched;  // indices of pieces to make; the others stay as they were
    std::size_t done = 0;              // of touched
  };

  void begin(const HostSlots& slots);
  void findChanges(const HostSlots& slots, const SlotPage& page, FoundChanges& found) const;
  Changes sorted(const std::vector<FoundChanges>& parts) const;
  static Cell cellOf(const Known& known, const SlotPage& of, const HostSlots::Page& page,
                     std::uint32_t i);
  void rememberCells(const HostSlots& slots, const SlotPage& page);
  void nextLevel();
  bool isLast(const Pages& pages) const;
  std::vector<Cell> touchedCells(int level, const Pages& finer) const;
  void cut(int level, const std::vector<Cell>& touched, std::vector<Piece>& pieces,
           std::vector<std::size_t>& touched_pieces) const;
  void make(const HostSlots& slots, std::size_t count);
  Made nodesOf(const HostSlots& slots, const Piece& piece, std::size_t begin,
               std::size_t end) const;
  void fill(Piece& piece, const std::vector<Made>& made, int sh_degree) const;
  void publish(HostSlots& slots) const;
  LevelSamples sampled(const Nodes& nodes, std::uint32_t group) const;

  std::shared_ptr<ThreadTeam> team_;
  bool begun_ = false;
  std::vector<std::unique_ptr<Known>> known_;                   // by place
  std::map<std::uint32_t, std::vector<std::uint32_t>> marked_;  // first slots of pages, by group
  std::uint32_t next_group_ = 0;                                // whose turn is next, by index
  std::unique_ptr<Job> job_;
  std::vector<Nodes> nodes_;           // by group
  std::vector<Entering> entering_;     // by group
  std::vector<LevelSamples> samples_;  // by group
};

// The width of the parents' cells of a level that has nodes: kBoundless for the group's last level,
// whose nodes have no parents. [m]
float parentSize(const Levels::Nodes& nodes, int level);

}  // namespace rosplat
