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
  float log2_peak;  // of its opacity
  float colour[3];
  float depth;
  std::int16_t left, top, right, bottom;  // pixels around it, the last two beyond it
};

// What a picture's error would have of a splat in one tile: sums over pixels of p, the derivative
// by the logarithm of alpha, and of the derivative by the colour.
struct FitSums {
  float p, px, py, pxx, pxy, pyy;  // p, times the way from the centre to the pixel [px]
  float colour[3];
};

struct FitTile {
  const std::uint32_t* listed;  // nearest first
  std::size_t count;
  const FitSplat* splats;
  int left, top, right, bottom;  // pixels of the picture, the last two beyond
  int width;                     // of the picture [px]
  const float* target;           // the picture's, RGB interleaved, 0 to 1
  float gradient_scale;          // of a pixel's difference
  FitSums* sums;                 // of the listed, one for each
};

// Draws a tile and goes back through it. Returns the sum of squares by which it differs from its
// target, where what is brighter than white is as bright.
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
