#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/slots/model.hpp"
#include "rosplat_core/slots/splat_arrays.hpp"

namespace rosplat {

// Splats in arrays of another owner, in the units and conventions of rosplat_msgs/GaussianArray.
struct SplatsView {
  SplatArrays<const float> arrays;
  // Packed slots, each with its further bands behind it (packed_slot.hpp), in place of the arrays.
  const std::uint32_t* rows = nullptr;
  std::array<double, 3> origin{};                              // added to each position [m]
  Model model = Model::kEwa;                                   // how they are drawn
  std::vector<std::pair<std::string, const float*>> channels;  // a value for each splat

  // Of the i-th splat, relative to the origin. [m]
  std::array<float, 3> position(std::size_t i) const;
  // Throws std::invalid_argument, which names the field, for an origin that is not finite and for
  // an invalid or repeated channel name.
  void check() const;
};

// A set of n 3D Gaussians with view-dependent colour (Kerbl et al. 2023), in the units and
// conventions of rosplat_msgs/GaussianArray.
struct Splats {
  std::vector<float> positions;     // 3 n: means x y z, relative to the origin [m]
  std::vector<float> orientations;  // 4 n: quaternions x y z w, of any length but zero
  std::vector<float> scales;        // 3 n: standard deviations, not their logarithms [m]
  std::vector<float> opacities;     // n: 0 to 1, not logits
  // 3 (degree + 1)^2 n, for a degree of 0 to 3: spherical harmonics, coefficient-major, RGB
  // interleaved. colour = max(0, 0.5 + 0.28209479 c0 + ...)
  std::vector<float> sh;
  std::array<double, 3> origin{};  // added to each position [m]
  Model model = Model::kEwa;       // how they are drawn
  // Named values beside shape and colour, "label" say: n each, not finite where a splat has none.
  std::vector<std::pair<std::string, std::vector<float>>> channels;

  // Splats from what trainers optimise: quaternions of any length, logarithms of scales (3 n, or n
  // for spheres), logits of opacities, and harmonics as gsplat and 3DGS keep them: sh0
  // (features_dc), 3 n, and shN (features_rest), 0, 9 n, 24 n or 45 n for degree 0 to 3,
  // coefficient-major, RGB interleaved. Throws std::invalid_argument that names an array of another
  // length.
  static Splats fromTrained(std::vector<float> means, const std::vector<float>& quaternions_wxyz,
                            const std::vector<float>& log_scales, const std::vector<float>& logits,
                            const std::vector<float>& sh0, const std::vector<float>& shN = {});

  std::size_t size() const { return positions.size() / 3; }
  // Makes room for so many splats, and returns where.
  SplatArrays<float> resize(std::size_t n, int sh_degree);
  // A checked view of these splats. Throws std::invalid_argument, which names the field, if an
  // array's length doesn't fit that of positions, or if SplatsView::check() does.
  SplatsView view() const;
};

}  // namespace rosplat
