#pragma once

#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"

namespace rosplat {

// The splats of a payload, as arrays.
class DecodedPayload {
 public:
  // Returns a checked batch with its payload decoded to arrays, which this object owns; a batch
  // without a payload as it is. Throws BatchError for an invalid payload.
  GaussianBatch decode(const GaussianBatch& batch);

 private:
  std::vector<float> positions_;
  std::vector<float> orientations_;
  std::vector<float> scales_;
  std::vector<float> opacities_;
  std::vector<float> sh_;
};

}  // namespace rosplat
