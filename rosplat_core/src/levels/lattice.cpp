#include "rosplat_core/levels/lattice.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace rosplat {

namespace {

constexpr int kAxisBits = 19;                           // of a coordinate
constexpr std::int32_t kOffset = 1 << (kAxisBits - 1);  // to make it positive
constexpr int kTop = 3 * (kAxisBits - 1);               // place of the highest bits of all three
constexpr Cell kBelowTop = (Cell{1} << (kTop - 3)) - 1;
constexpr float kSigmas = 2;     // a cell is wider than so many standard deviations
constexpr float kLeast = 1e-9f;  // smaller sizes count as this [m]

// 2^octave, which must be a normal float; octaveOf() is its inverse, rounded down.
float powerOfTwo(int octave) {
  const std::uint32_t bits = std::uint32_t(127 + octave) << 23;
  float value;
  std::memcpy(&value, &bits, sizeof(bits));
  return value;
}
int octaveOf(float value) {
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return int(bits >> 23 & 255u) - 127;
}

// Puts two zeros before each bit; gathered() is the inverse.
Cell spread(std::uint32_t coordinate) {
  Cell x = coordinate;
  x = (x | x << 32) & 0x1f00000000ffff;
  x = (x | x << 16) & 0x1f0000ff0000ff;
  x = (x | x << 8) & 0x100f00f00f00f00f;
  x = (x | x << 4) & 0x10c30c30c30c30c3;
  return (x | x << 2) & 0x1249249249249249;
}

std::uint32_t gathered(Cell bits) {
  Cell x = bits & 0x1249249249249249;
  x = (x | x >> 2) & 0x10c30c30c30c30c3;
  x = (x | x >> 4) & 0x100f00f00f00f00f;
  x = (x | x >> 8) & 0x1f0000ff0000ff;
  x = (x | x >> 16) & 0x1f00000000ffff;
  return static_cast<std::uint32_t>(x | x >> 32);
}

}  // namespace

float cellSize(int level) {
  return level < kLevels ? powerOfTwo(kFinestOctave + level) : kBoundless;
}

Cell entryOf(const std::array<float, 3>& position, float largest_scale) {
  const float size = kSigmas * std::max(largest_scale, kLeast);
  float farthest = kLeast;
  for (const float x : position) farthest = std::max(farthest, std::fabs(x));
  const int octave =
      std::max({octaveOf(size) + 1, octaveOf(farthest) + 2 - kAxisBits, kFinestOctave});
  const int level = octave - kFinestOctave;
  return level < kLevels ? cellAt(position, level) : kNoCell;
}

Cell cellAt(const std::array<float, 3>& position, int level) {
  Cell cell = firstCell(level);
  const float per_metre = powerOfTwo(-(kFinestOctave + level));
  for (int axis = 0; axis < 3; ++axis) {
    const float along = position[axis] * per_metre;
    const auto toward_zero = static_cast<std::int32_t>(along);
    const std::int32_t at = toward_zero - int(along < float(toward_zero));
    cell |= spread(static_cast<std::uint32_t>(at + kOffset)) << axis;
  }
  return cell;
}

std::array<double, 3> cornerOf(Cell cell) {
  std::array<double, 3> corner;
  for (int axis = 0; axis < 3; ++axis) {
    const auto at = static_cast<std::int32_t>(gathered(cell >> axis & ((Cell{1} << (57)) - 1)));
    corner[axis] = double(at - kOffset) * cellSize(levelOf(cell));
  }
  return corner;
}

// A coordinate x + 2^18 becomes (x >> 1) + 2^18: the highest bit stays, its opposite comes in below
// it, and all other bits move down by one.
Cell parentOf(Cell cell) {
  const Cell top = cell >> kTop & 7;
  return firstCell(levelOf(cell) + 1) | top << kTop | (~top & 7) << (kTop - 3) |
         (cell >> 3 & kBelowTop);
}

bool hasChildren(Cell cell) { return parentOf(childrenOf(cell)) == cell; }

Cell childrenOf(Cell cell) {
  const Cell top = cell >> kTop & 7;
  return firstCell(levelOf(cell) - 1) | top << kTop | (cell & kBelowTop) << 3;
}

}  // namespace rosplat
