// rosplat_sorter._native: depth_order.hpp for Python.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "rosplat_sorter/depth_order.hpp"

namespace py = pybind11;

namespace {

using rosplat_sorter::DepthOrder;
using rosplat_sorter::View;

// As they are, without a silent copy or cast of a whole map.
using Floats = py::array_t<float, py::array::c_style>;

Floats floats(const py::handle& object, py::ssize_t size, const char* name) {
  if (!py::isinstance<Floats>(object)) {
    throw py::type_error(std::string(name) + " must be a contiguous float32 array");
  }
  auto array = py::reinterpret_borrow<Floats>(object);
  if (array.size() != size) throw py::value_error(std::string(name) + " has the wrong size");
  return array;
}

// The view of a rosplat_sorter.view.View.
View toView(const py::handle& object) {
  View view;
  const auto number = [&](const char* name) { return object.attr(name).cast<float>(); };
  const Floats rotation(py::reinterpret_borrow<py::object>(object.attr("rotation")));
  const Floats translation(py::reinterpret_borrow<py::object>(object.attr("translation")));
  if (rotation.size() != 9 || translation.size() != 3) {
    throw py::value_error("view.rotation must be 3 x 3 and view.translation 3");
  }
  std::copy_n(rotation.data(), 9, view.rotation);
  std::copy_n(translation.data(), 3, view.translation);
  view.fx = number("fx");
  view.fy = number("fy");
  view.offset_x = number("offset_x");
  view.offset_y = number("offset_y");
  view.half_width = number("half_width");
  view.half_height = number("half_height");
  view.slope_x = number("slope_x");
  view.slope_y = number("slope_y");
  view.near_clip = number("near_clip");
  view.far_clip = number("far_clip");
  view.orthographic = object.attr("orthographic").cast<bool>();
  return view;
}

py::array_t<std::uint32_t> sort(DepthOrder& sorter, const py::object& view_object,
                                const py::object& positions_object,
                                const py::object& extents_object) {
  const View view = toView(view_object);
  const auto count = static_cast<py::ssize_t>(py::len(extents_object));
  const Floats extents = floats(extents_object, count, "extents");
  const Floats positions = floats(positions_object, 3 * count, "positions");
  const float* const p = positions.data();
  const float* const e = extents.data();
  const std::vector<std::uint32_t>* order = nullptr;
  {
    const py::gil_scoped_release release;
    order = &sorter.sort(view, p, e, static_cast<std::size_t>(count));
  }
  return py::array_t<std::uint32_t>(static_cast<py::ssize_t>(order->size()), order->data());
}

}  // namespace

PYBIND11_MODULE(_native, module) {
  module.doc() = "The exact depth order of depth_order.hpp.";
  py::class_<DepthOrder>(module, "DepthOrder", "Keeps its workspace and threads between calls.")
      .def(py::init<unsigned>(), py::arg("threads") = 0,
           "threads: to sort with, 0 for as many as the machine runs at once.")
      .def_property_readonly("threads", &DepthOrder::threads)
      .def(
          "sort", &sort, py::arg("view"), py::arg("positions"), py::arg("extents"),
          "The visible slots back to front, uint32 (m,).\n\n"
          "view: a rosplat_sorter.view.View. positions: float32 (n, 3) [m]. extents: float32 (n,)\n"
          "[m], negative for what is never visible. Both contiguous; other types raise TypeError,\n"
          "other sizes ValueError. One thread at a time.");
}
