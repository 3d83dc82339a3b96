// Splats between Python and C++: read from arrays without a copy, and handed back as arrays.

#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/python/bindings.hpp"
#include "rosplat_core/slots/model.hpp"
#include "rosplat_core/slots/packed_slot.hpp"
#include "rosplat_core/slots/splats.hpp"

namespace rosplat::python {

// Holds the arrays of Python's splats and views them, whatever object has them under their names.
struct HeldArrays {
  std::vector<py::object> held;
  SplatArrays<const float> arrays;

  explicit HeldArrays(std::size_t count) { arrays.count = count; }

  // `each` values for each splat. Throws std::invalid_argument for another number.
  template <typename T>
  const T* keep(const std::string& name, const py::handle& values, std::size_t each) {
    const auto array = values.cast<Array<T>>();
    if (static_cast<std::size_t>(array.size()) != each * arrays.count) {
      throw std::invalid_argument(name + ": expected " + std::to_string(each) +
                                  " values for each of " + std::to_string(arrays.count) +
                                  " splats, got " + std::to_string(array.size()));
    }
    held.push_back(array);
    return array.data();
  }
  void read(const py::object& splats) {
    const auto sh = splats.attr("sh").cast<Array<float>>();
    const py::ssize_t coefficients = sh.ndim() == 3 ? sh.shape(1) : 1;
    int& degree = arrays.sh_degree;
    while (degree < kMaxShDegree && coefficients > (degree + 1) * (degree + 1)) ++degree;
    const auto array = [&](const char* name, std::size_t each) {
      return keep<float>(name, splats.attr(name), each);
    };
    arrays.positions = array("positions", 3);
    arrays.orientations = array("orientations", 4);
    arrays.scales = array("scales", 3);
    arrays.opacities = array("opacities", 1);
    arrays.sh = keep<float>("sh", sh, arrays.shStride());
  }
};

// The same for Python's Splats or PackedSplats.
struct HeldSplats : HeldArrays {
  SplatsView view;

  explicit HeldSplats(const py::object& splats) : HeldArrays(py::len(splats)) {
    if (py::hasattr(splats, "rows")) {
      arrays.sh_degree = splats.attr("sh_degree").cast<int>();
      const auto words = static_cast<std::size_t>(rowWords(arrays.sh_degree));
      view.rows = keep<std::uint32_t>("rows", splats.attr("rows"), words);
    } else {
      read(splats);
    }
    view.arrays = arrays;
    view.origin = splats.attr("origin").cast<std::array<double, 3>>();
    view.model = modelOf(splats.attr("model").cast<int>());
    for (const py::handle item : splats.attr("channels").attr("items")()) {
      const auto& [name, values] = item.cast<std::pair<std::string, py::object>>();
      view.channels.emplace_back(name, keep<float>("channels '" + name + "'", values, 1));
    }
  }
};

// The arrays of Python's Splats by name.
template <typename Position>
py::dict arraysOf(std::vector<Position> positions, std::vector<float> orientations,
                  std::vector<float> scales, std::vector<float> opacities, std::vector<float> sh) {
  const auto n = static_cast<py::ssize_t>(opacities.size());
  const auto k = n > 0 ? static_cast<py::ssize_t>(sh.size()) / (3 * n) : 1;
  return py::dict("positions"_a = toArray(std::move(positions), {n, 3}),
                  "orientations"_a = toArray(std::move(orientations), {n, 4}),
                  "scales"_a = toArray(std::move(scales), {n, 3}),
                  "opacities"_a = toArray(std::move(opacities), {n}),
                  "sh"_a = toArray(std::move(sh), {n, k, 3}));
}

inline py::dict arraysOf(Splats&& splats) {
  return arraysOf(std::move(splats.positions), std::move(splats.orientations),
                  std::move(splats.scales), std::move(splats.opacities), std::move(splats.sh));
}

}  // namespace rosplat::python
