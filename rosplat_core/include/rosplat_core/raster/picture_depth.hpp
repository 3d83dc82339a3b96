#pragma once

namespace rosplat {

// How a pixel's depth follows from the depths (z of the centres) of the splats that it shows.
enum class PictureDepth {
  kNone,
  kMean,    // weighted by each splat's contribution
  kMedian,  // of the splat that brings the transmittance to 0.5 or less; none if no splat does
};

// Sums over pixels, those behind translucent objects included: of alpha, and of alpha times the
// mean depth [m] or, in perspective, its inverse.
struct DepthSums {
  float depth, alpha;
};

}  // namespace rosplat
