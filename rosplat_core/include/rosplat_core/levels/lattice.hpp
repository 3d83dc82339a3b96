#pragma once

#include <array>
#include <cstdint>

#include "rosplat_core/map/host_slots.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/packed_slot.hpp"

namespace rosplat {

// A cube of one of a few lattices in a group's frame, each twice as wide as the one before, with a
// corner at the group's origin: so each cell lies in one of the next level. As a number by which
// cells sort by level, then in Morton's order; parents sort as their children do.
using Cell = std::uint64_t;
constexpr Cell kNoCell = ~Cell{0};

// Of a level's cells; kBoundless of those beyond the last level. [m]
float cellSize(int level);
// The least of a level's, or one that is greater than all of the level before.
inline Cell firstCell(int level) { return Cell(level) << 57; }
inline int levelOf(Cell cell) { return static_cast<int>(cell >> 57); }
// Where a splat enters: in the first cells that are wider than it is, and near enough to the origin
// to be counted (2^18 of them to either side). kNoCell for one that is too large or too far.
Cell entryOf(const std::array<float, 3>& position, float largest_scale);
// The cell around a position, relative to the group's origin [m], which must be near enough.
Cell cellAt(const std::array<float, 3>& position, int level);
// The corner of the least coordinates. [m]
std::array<double, 3> cornerOf(Cell cell);

// Of the next level, which there must be.
Cell parentOf(Cell cell);
// The first of the eight cells of the level before that lie in this one, one after the other.
Cell childrenOf(Cell cell);

}  // namespace rosplat
