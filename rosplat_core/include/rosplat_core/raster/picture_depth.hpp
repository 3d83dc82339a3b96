#pragma once

namespace rosplat {

// Which depth a pixel has, along z, of the centres of the splats that it shows.
enum class PictureDepth {
  kNone,
  kMean,    // weighted by what each contributes
  kMedian,  // of the splat that leaves half of the light through, or less; none where no splat does
};

}  // namespace rosplat
