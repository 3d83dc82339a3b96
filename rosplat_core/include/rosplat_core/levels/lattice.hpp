#pragma once

#include <array>
#include <cstdint>

#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/packed_slot.hpp"

namespace rosplat {

// A cell: a cube of one level's lattice in a group's frame. Cells are twice as wide as those of the
// level before, with a corner at the group's origin, so each lies in one cell of the next level.
// The numbers sort cells by level, then in Morton order; parents sort as their children do.
using Cell = std::uint64_t;
constexpr Cell kNoCell = ~Cell{0};

// The width of a level's cells; kBoundless beyond the last level. [m]
float cellSize(int level);
// The least cell of a level: greater than all of the level before. level: kLevels at most.
inline Cell firstCell(int level) { return Cell(level) << 57; }
inline int levelOf(Cell cell) { return static_cast<int>(cell >> 57); }
// The cell at which a splat enters: of the first level whose cells are wider than twice its largest
// scale and reach its position (2^18 cells either side). kNoCell if it is too large or too far.
Cell entryOf(const std::array<float, 3>& position, float largest_scale);
// The cell around a position relative to the group's origin [m]. The level's cells must reach it.
Cell cellAt(const std::array<float, 3>& position, int level);
// The corner of the least coordinates. [m]
std::array<double, 3> cornerOf(Cell cell);

// The cell of the next level around this one; there must be a next level.
Cell parentOf(Cell cell);
// Whether the level before reaches a cell: its lattice is half as wide, so not all have children.
bool hasChildren(Cell cell);
// The first of the eight cells of the level before that lie in this one: consecutive numbers. The
// cell must have children.
Cell childrenOf(Cell cell);

}  // namespace rosplat
