#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "map/gaussian_batch.hpp"

namespace rosplat {

// The format of a payload that is known. rosplat_sorter/payload.py describes it, and encodes it.
constexpr const char* kPayloadFormat = "quantised";

// Bytes of the payload of so many splats.
std::size_t payloadBytes(std::size_t count, int sh_degree);

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
