#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "rosplat_core/slots/packed_rows.hpp"
#include "rosplat_core/slots/payload.hpp"

namespace rosplat {

// A format of GaussianArray.payload.
struct PayloadFormat {
  std::size_t (*size)(std::size_t count, int sh_degree);
  // Fills arrays with the splats of a payload of size() bytes.
  void (*decode)(const std::uint8_t* payload, const SplatArrays<float>& splats);
};

// The format of a name. Throws std::invalid_argument if there is none.
inline PayloadFormat payloadFormat(const std::string& name) {
  if (name == packed_rows::kFormat) return {packed_rows::size, packed_rows::decode};
  if (name == payload::kFormat) return {payload::size, payload::decode};
  throw std::invalid_argument("format '" + name.substr(0, 40) + "' is unknown");
}

}  // namespace rosplat
