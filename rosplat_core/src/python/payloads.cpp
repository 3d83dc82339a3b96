// Splats as they travel in a payload, for Python.

#include <vector>

#include "python/module.hpp"
#include "rosplat_core/python/bindings.hpp"
#include "rosplat_core/slots/payload.hpp"

namespace rosplat::python {

namespace {

using Floats = Array<float>;

// The arrays of a rosplat_core.payload.Arrays, which has to outlive them.
struct HeldArrays {
  std::vector<Floats> arrays;
  SplatArrays<const float> splats;
  std::vector<bool> usable;

  HeldArrays(const py::object& given, const Array<bool>& of)
      : usable(of.data(), of.data() + of.size()) {
    const std::size_t n = splats.count = usable.size();
    const auto array = [&](const char* name, std::size_t each) {
      arrays.push_back(given.attr(name).cast<Floats>());
      if (static_cast<std::size_t>(arrays.back().size()) == each * n) return arrays.back().data();
      throw std::invalid_argument(std::string(name) + ": not as long as usable asks for");
    };
    const auto coefficients = given.attr("sh").cast<Floats>();
    while (splats.sh_degree < 3 && coefficients.ndim() == 3 &&
           coefficients.shape(1) > (splats.sh_degree + 1) * (splats.sh_degree + 1)) {
      ++splats.sh_degree;
    }
    splats.positions = array("positions", 3);
    splats.orientations = array("orientations", 4);
    splats.scales = array("scales", 3);
    splats.opacities = array("opacities", 1);
    splats.sh = array("sh", splats.shStride());
  }
};

Array<std::uint8_t> encode(const py::object& arrays, const Array<bool>& usable) {
  const HeldArrays held(arrays, usable);
  std::vector<std::uint8_t> bytes(payload::size(held.splats.count, held.splats.sh_degree));
  {
    const py::gil_scoped_release free;
    payload::encode(held.splats, held.usable, bytes.data());
  }
  const auto size = static_cast<py::ssize_t>(bytes.size());
  return toArray(std::move(bytes), {size});
}

bool suits(const py::object& arrays, const Array<bool>& usable) {
  const HeldArrays held(arrays, usable);
  const py::gil_scoped_release free;
  return payload::suits(held.splats, held.usable);
}

py::dict decode(const Array<std::uint8_t>& bytes, std::size_t count, int sh_degree) {
  if (static_cast<std::size_t>(bytes.size()) != payload::size(count, sh_degree)) {
    throw std::invalid_argument("payload has " + std::to_string(bytes.size()) + " bytes, " +
                                std::to_string(payload::size(count, sh_degree)) + " expected of " +
                                payload::kFormat);
  }
  const auto n = static_cast<py::ssize_t>(count);
  const Floats positions({n, py::ssize_t{3}}), orientations({n, py::ssize_t{4}}),
      scales({n, py::ssize_t{3}}), opacities(n),
      sh({n, py::ssize_t{(sh_degree + 1) * (sh_degree + 1)}, py::ssize_t{3}});
  const auto to = [](Floats array) { return array.mutable_data(); };
  const SplatArrays<float> splats = {count,      sh_degree,     to(positions), to(orientations),
                                     to(scales), to(opacities), to(sh)};
  {
    const py::gil_scoped_release free;
    payload::decode(bytes.data(), splats);
  }
  return py::dict("positions"_a = positions, "orientations"_a = orientations, "scales"_a = scales,
                  "opacities"_a = opacities, "sh"_a = sh);
}

}  // namespace

void definePayloads(py::module_& module) {
  module.def("encode_payload", &encode, "arrays"_a, "usable"_a);
  module.def("payload_suits", &suits, "arrays"_a, "usable"_a);
  module.def("decode_payload", &decode, "payload"_a, "count"_a, "sh_degree"_a);
  module.def("payload_size", &payload::size, "count"_a, "sh_degree"_a);
}

}  // namespace rosplat::python
