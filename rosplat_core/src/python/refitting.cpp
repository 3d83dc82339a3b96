// Refitting for Python.

#include <memory>

#include "python/module.hpp"
#include "rosplat_core/python/bindings.hpp"
#include "rosplat_core/refit/refit.hpp"
#include "rosplat_core/slots/model.hpp"

namespace rosplat::python {

namespace {

std::unique_ptr<Refit> refitOf(const Array<float>& positions, const Array<float>& orientations,
                               const Array<float>& scales, const Array<float>& opacities,
                               const Array<float>& sh, const std::array<double, 3>& origin,
                               int model, unsigned threads,
                               CpuRasterizer::Instructions instructions) {
  SplatsView splats;
  SplatArrays<const float>& arrays = splats.arrays;
  const auto count = opacities.size(), coefficients = sh.ndim() == 3 ? sh.shape(1) : 0;
  while ((arrays.sh_degree + 1) * (arrays.sh_degree + 1) < coefficients) ++arrays.sh_degree;
  const bool fits = positions.size() == 3 * count && orientations.size() == 4 * count &&
                    scales.size() == 3 * count && arrays.sh_degree <= 3 &&
                    (arrays.sh_degree + 1) * (arrays.sh_degree + 1) == coefficients &&
                    sh.size() == 3 * coefficients * count;
  if (!fits) throw std::invalid_argument("the arrays are not of the same splats");
  arrays.count = static_cast<std::size_t>(count);
  arrays.positions = positions.data();
  arrays.orientations = orientations.data();
  arrays.scales = scales.data();
  arrays.opacities = opacities.data();
  arrays.sh = sh.data();
  splats.origin = origin;
  splats.model = modelOf(model);
  return std::make_unique<Refit>(splats, std::make_shared<ThreadTeam>(threads), instructions);
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
      .def(py::init(&refitOf), "positions"_a, "orientations"_a, "scales"_a, "opacities"_a, "sh"_a,
           "origin"_a, "model"_a, "threads"_a = 0,
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
      .def("splats", [](const Refit& refit) {
        Splats splats = refit.splats();
        const auto n = static_cast<py::ssize_t>(splats.size());
        const auto coefficients = n > 0 ? static_cast<py::ssize_t>(splats.sh.size()) / (3 * n) : 1;
        return py::dict("positions"_a = toArray(std::move(splats.positions), {n, 3}),
                        "orientations"_a = toArray(std::move(splats.orientations), {n, 4}),
                        "scales"_a = toArray(std::move(splats.scales), {n, 3}),
                        "opacities"_a = toArray(std::move(splats.opacities), {n}),
                        "sh"_a = toArray(std::move(splats.sh), {n, coefficients, 3}));
      });
}

}  // namespace rosplat::python
