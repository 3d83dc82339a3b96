// Refitting for Python.

#include <memory>

#include "python/held_splats.hpp"
#include "python/module.hpp"
#include "rosplat_core/refit/refit.hpp"

namespace rosplat::python {

namespace {

std::unique_ptr<Refit> refitOf(const py::object& splats, unsigned threads,
                               CpuRasterizer::Instructions instructions) {
  return std::make_unique<Refit>(HeldSplats(splats).view, std::make_shared<ThreadTeam>(threads),
                                 instructions);
}

const float* targetOf(const SplatCamera& camera, const Array<float>& target) {
  if (target.ndim() != 3 || target.shape(0) != camera.height || target.shape(1) != camera.width ||
      target.shape(2) != 3) {
    throw std::invalid_argument("target: expected RGB in each of the camera's pixels");
  }
  return target.data();
}

}  // namespace

void defineRefitting(py::module_& module) {
  py::class_<RefitRates>(module, "RefitRates")
      .def(py::init([](float position, float scale, float rotation, float opacity, float colour,
                       float bands) {
             return RefitRates{position, scale, rotation, opacity, colour, bands};
           }),
           py::kw_only(), "position"_a, "scale"_a, "rotation"_a, "opacity"_a, "colour"_a,
           "bands"_a);
  py::class_<Refit>(module, "Refit")
      .def(py::init(&refitOf), "splats"_a, "threads"_a = 0,
           "instructions"_a = CpuRasterizer::Instructions::kBest)
      .def(
          "step",
          [](Refit& refit, const SplatCamera& camera, const Array<float>& target,
             const RefitRates& rates) {
            const float* const values = targetOf(camera, target);
            const py::gil_scoped_release release;
            return refit.step(camera, values, rates);
          },
          "camera"_a, "target"_a, "rates"_a)
      .def(
          "gradient_at",
          [](Refit& refit, const SplatCamera& camera, const Array<float>& target) {
            const float* const values = targetOf(camera, target);
            std::vector<float> gradient;
            double error = 0;
            {
              const py::gil_scoped_release release;
              error = refit.gradientAt(camera, values, gradient);
            }
            const auto columns = static_cast<py::ssize_t>(refit.values());
            const auto rows = static_cast<py::ssize_t>(gradient.size()) / columns;
            return py::make_tuple(error, toArray(std::move(gradient), {rows, columns}));
          },
          "camera"_a, "target"_a)
      .def("splats", [](const Refit& refit) { return arraysOf(refit.splats()); });
}

}  // namespace rosplat::python
