#include "python/module.hpp"

PYBIND11_MODULE(_core, module) {
  module.doc() = "The engine in C++: what the package's modules are made of.";
  rosplat::python::defineMaps(module);
  rosplat::python::defineOccupancy(module);
  rosplat::python::defineOrders(module);
  rosplat::python::definePayloads(module);
  rosplat::python::definePublishing(module);
  rosplat::python::defineRendering(module);
  rosplat::python::defineRefitting(module);
}
