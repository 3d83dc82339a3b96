#pragma once

// The loop over pixels that refitting spends its time in, compiled for several targets from one
// source; plain types alone, see raster/simd.hpp.

#include <cstddef>
#include <cstdint>

#include "rosplat_core/slots/constants.hpp"

namespace rosplat::cpu {

// A splat in a picture: alpha = opacity exp(-(a dx^2 + 2 b dx dy + c dy^2) / 2).
struct FitSplat {
  float x, y;       // centre [px]
  float a, b, c;    // inverse of its covariance [1/px^2]
  float log2_peak;  // log2 of its peak alpha
  float colour[3];
  float depth;
  std::int16_t left, top, right, bottom;  // pixels; right and bottom are exclusive
};

// The gradient of the error by a splat in one tile: sums over the pixels of p, the derivative by
// the logarithm of alpha, and of the derivative by the colour.
struct FitSums {
  float p, px, py, pxx, pxy, pyy;  // p times powers of dx, dy: centre to pixel [px]
  float colour[3];
};

struct FitTile {
  const std::uint32_t* listed;  // nearest first
  std::size_t count;
  const FitSplat* splats;
  int left, top, right, bottom;  // pixels of the picture; right, bottom exclusive
  int width;                     // of the picture [px]
  const float* target;           // of the picture, RGB interleaved, 0 to 1
  float gradient_scale;          // from a pixel's difference to its gradient
  FitSums* sums;                 // one for each of the listed
};

// Draws a tile and fills its sums. Returns the sum of squared differences from the target, in which
// a colour above 1 counts as 1.
using FitTileFunction = double (*)(const FitTile& tile);

namespace plain {
double fitTile(const FitTile& tile);
}
namespace avx2 {
double fitTile(const FitTile& tile);
}
namespace avx512 {
double fitTile(const FitTile& tile);
}

}  // namespace rosplat::cpu
