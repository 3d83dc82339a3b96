#pragma once

#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"

namespace rosplat {

// The splats of a payload, as arrays.
class DecodedPayload {
 public:
  // A checked batch with views of these arrays, which are its payload's; the batch as it is where
  // it has none. Throws BatchError for a payload that makes no sense.
  GaussianBatch decode(const GaussianBatch& batch);

 private:
  std::vector<float> positions_;
  std::vector<float> orientations_;
  std::vector<float> scales_;
  std::vector<float> opacities_;
  std::vector<float> sh_;
};

}  // namespace rosplat
