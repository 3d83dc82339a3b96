// Occupancy for Python.

#include "python/module.hpp"
#include "rosplat_core/occupancy/voxel_map.hpp"
#include "rosplat_core/python/bindings.hpp"

namespace rosplat::python {

namespace {

// A map as occupancy needs it: harmonics are checked, and not kept.
struct OccupancyMap : GaussianMap {
  OccupancyMap(const VoxelGrid& grid, unsigned threads) : GaussianMap(0), voxels(grid, threads) {}

  VoxelMap voxels;
};

VoxelSurface found(const OccupancyMap& map, double least_depth, bool surface) {
  const py::gil_scoped_release release;
  return map.voxels.find(least_depth, surface);
}

}  // namespace

void defineOccupancy(py::module_& module) {
  py::class_<OccupancyMap, GaussianMap> map(module, "OccupancyMap",
                                            "A map as light that its splats take away in voxels.");
  map.def(py::init([](double resolution, int across, unsigned threads, std::size_t most) {
            return std::make_unique<OccupancyMap>(VoxelGrid{resolution, across, most}, threads);
          }),
          "resolution"_a, "across"_a, "threads"_a = 0, "most"_a = VoxelGrid().most)
      .def(
          "place",
          [](OccupancyMap& m, const std::array<double, 3>& position,
             const std::array<double, 4>& orientation) {
            const py::gil_scoped_release release;
            m.voxels.place(makePlacement(position, orientation));
          },
          "position"_a, "orientation"_a,
          "Where the map's frame is in the grid's: position [m], quaternion x y z w.")
      .def(
          "find",
          [](const OccupancyMap& m, double least_depth) {
            const VoxelSurface voxels = found(m, least_depth, false);
            return py::make_tuple(toArray(voxels.cells), toArray(voxels.depths));
          },
          "least_depth"_a, "Cells int32 (n, 3) and optical depths along x, y, z float32 (n, 3).")
      .def(
          "surface",
          [](const OccupancyMap& m, double least_depth) {
            const VoxelSurface voxels = found(m, least_depth, true);
            return py::dict(
                "cells"_a = toArray(voxels.cells), "positions"_a = toArray(voxels.positions),
                "normals"_a = toArray(voxels.normals), "colors"_a = toArray(voxels.colors));
          },
          "least_depth"_a, "Of the same voxels: int32 cells and float32 of the others, (n, 3).")
      .def_property_readonly("too_large", [](const OccupancyMap& m) { return m.voxels.tooLarge(); })
      .def_property_readonly("beyond", [](const OccupancyMap& m) { return m.voxels.beyond(); })
      .def_property_readonly(
          "full", [](const OccupancyMap& m) { return m.voxels.full(); },
          "Whether there would be too many voxels, and are none therefore.")
      .def_property_readonly(
          "most", [](const OccupancyMap& m) { return m.voxels.most(); },
          "How many voxels are held.")
      .def_property_readonly("voxels", [](const OccupancyMap& m) { return m.voxels.voxels(); });
  defineApply(map, [](OccupancyMap& m, const GaussianBatch& batch) {
    return apply(m, batch, [&m](const GaussianEdit& edit) { m.voxels.apply(edit); });
  });
}

}  // namespace rosplat::python
