#pragma once

#include <pybind11/pybind11.h>

namespace rosplat::python {

void defineMaps(pybind11::module_& module);
void defineOccupancy(pybind11::module_& module);
void defineOrders(pybind11::module_& module);
void definePayloads(pybind11::module_& module);
void definePublishing(pybind11::module_& module);
void defineRefitting(pybind11::module_& module);
void defineRendering(pybind11::module_& module);

}  // namespace rosplat::python
