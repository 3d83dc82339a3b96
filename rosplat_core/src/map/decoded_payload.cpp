#include "rosplat_core/map/decoded_payload.hpp"

#include <stdexcept>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/slots/payload_format.hpp"

namespace rosplat {

GaussianBatch DecodedPayload::decode(const GaussianBatch& batch) {
  if (batch.format.empty()) return batch;
  SplatArrays<float> splats;
  splats.count = batch.count;
  splats.sh_degree = batch.sh_degree;
  const auto make = [&](std::vector<float>& array, std::size_t each) {
    array.resize(each * splats.count);
    return array.data();
  };
  splats.positions = make(positions_, 3);
  splats.orientations = make(orientations_, 4);
  splats.scales = make(scales_, 3);
  splats.opacities = make(opacities_, 1);
  splats.sh = make(sh_, splats.shStride());
  try {
    payloadFormat(batch.format).decode(batch.payload.data, splats);
  } catch (const std::invalid_argument& error) {
    throw BatchError(error.what());
  }
  GaussianBatch decoded = batch;
  decoded.positions = positions_;
  decoded.orientations = orientations_;
  decoded.scales = scales_;
  decoded.opacities = opacities_;
  decoded.sh = sh_;
  return decoded;
}

}  // namespace rosplat
