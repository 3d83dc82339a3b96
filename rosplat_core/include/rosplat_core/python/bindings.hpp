// What the Python bindings of maps share. Not a part of the engine, which doesn't know Python.

#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat::python {

namespace py = pybind11;
using namespace py::literals;

template <typename T>
using Array = py::array_t<T, py::array::c_style>;

template <typename T>
Array<T> toArray(std::vector<T> values, std::vector<py::ssize_t> shape) {
  auto* owner = new std::vector<T>(std::move(values));
  const py::capsule capsule(owner, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return Array<T>(std::move(shape), owner->data(), capsule);
}

// Points, float64 (n, 3).
inline Array<double> toArray(const std::vector<std::array<double, 3>>& points) {
  Array<double> array({static_cast<py::ssize_t>(points.size()), py::ssize_t{3}});
  for (std::size_t i = 0; i < points.size(); ++i) {
    std::copy(points[i].begin(), points[i].end(), array.mutable_data() + 3 * i);
  }
  return array;
}

// Poses from 7 numbers each: position [m], quaternion x y z w.
inline std::vector<Pose> posesOf(const Array<double>& values) {
  const ArrayView<double> numbers = values;
  if (numbers.size % 7 != 0) throw BatchError("poses are of 7 numbers each");
  std::vector<Pose> poses(numbers.size / 7);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const double* const pose = &numbers[7 * i];
    poses[i] = {{pose[0], pose[1], pose[2]}, {pose[3], pose[4], pose[5], pose[6]}};
  }
  return poses;
}

// A camera from the arguments of Python's SplatCamera and set_camera.
inline SplatCamera cameraOf(const std::array<double, 3>& position,
                            const std::array<double, 4>& orientation, int projection, double fx,
                            double fy, double cx, double cy, double width, double height,
                            double near_clip, double far_clip) {
  if (projection != 0 && projection != 1) {
    throw std::invalid_argument("projection " + std::to_string(projection) + " is unknown");
  }
  return makeCamera(position, orientation, projection == 1, fx, fy, cx, cy, width, height,
                    near_clip, far_clip);
}

// A method `apply` with the fields of a GaussianArray. take: a function of the target and a batch.
template <typename Target, typename... Bases, typename Take>
void defineApply(py::class_<Target, Bases...>& type, Take take) {
  type.def(
      "apply",
      [take](Target& target, std::uint8_t operation, std::uint32_t first_slot, std::uint32_t count,
             const Array<std::uint32_t>& slots, std::uint8_t sh_degree, std::uint8_t model,
             const std::array<double, 3>& origin, const Array<float>& positions,
             const Array<float>& orientations, const Array<float>& scales,
             const Array<float>& opacities, const Array<float>& sh, const std::string& map_id,
             std::uint64_t revision, std::uint32_t expected_slots, const std::string& format,
             const Array<std::uint8_t>& payload, Arrival arrival, std::uint32_t group,
             const Array<std::uint32_t>& groups, const Array<double>& poses,
             const std::vector<std::string>& channel_names, const Array<float>& channels) {
        GaussianBatch batch;
        batch.operation = operation;
        batch.first_slot = first_slot;
        batch.count = count;
        batch.slots = slots;
        batch.sh_degree = sh_degree;
        batch.model = model;
        batch.origin = origin;
        batch.positions = positions;
        batch.orientations = orientations;
        batch.scales = scales;
        batch.opacities = opacities;
        batch.sh = sh;
        batch.map_id = map_id;
        batch.revision = revision;
        batch.expected_slots = expected_slots;
        batch.format = format;
        batch.payload = payload;
        batch.arrival = arrival;
        batch.group = group;
        batch.groups = groups;
        batch.poses = posesOf(poses);
        batch.channel_names = channel_names;
        batch.channels = channels;
        BatchReport report;
        {
          const py::gil_scoped_release release;
          report = take(target, batch);
        }
        return py::dict("missed"_a = report.missed, "dropped"_a = report.dropped);
      },
      "operation"_a, "first_slot"_a, "count"_a, "slots"_a, "sh_degree"_a, "model"_a, "origin"_a,
      "positions"_a, "orientations"_a, "scales"_a, "opacities"_a, "sh"_a, "map_id"_a, "revision"_a,
      "expected_slots"_a = 0, "format"_a = "", "payload"_a = Array<std::uint8_t>(0),
      "arrival"_a = Arrival::kHeard, "group"_a = 0, "groups"_a = Array<std::uint32_t>(0),
      "poses"_a = Array<double>(0), "channel_names"_a = std::vector<std::string>(),
      "channels"_a = Array<float>(0));
}

}  // namespace rosplat::python
