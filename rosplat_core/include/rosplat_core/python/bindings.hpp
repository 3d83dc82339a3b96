// What the Python bindings of maps share. Not a part of the engine, which doesn't know Python.

#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <limits>
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

// Triples, (n, 3).
template <typename T>
Array<T> toArray(const std::vector<std::array<T, 3>>& rows) {
  Array<T> array({static_cast<py::ssize_t>(rows.size()), py::ssize_t{3}});
  T* to = array.mutable_data();
  for (const auto& row : rows) to = std::copy(row.begin(), row.end(), to);
  return array;
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

// Reads a GaussianArray, or anything with its fields, by name. Fields that are missing are as in an
// empty message. Holds what the batch's arrays refer to.
class ReadBatch {
 public:
  explicit ReadBatch(py::object message) : message_(std::move(message)) {
#define READ(field) read(#field, batch_.field);
    ROSPLAT_BATCH_FIELDS(READ)
    ROSPLAT_RECEIVED_ARRAYS(READ)
#undef READ
    if (py::hasattr(message_, "origin")) batch_.origin = pointOf(message_.attr("origin"));
    readPoses();
  }

  GaussianBatch& batch() { return batch_; }

 private:
  template <typename T>
  void read(const char* name, T& value) const {
    if (py::hasattr(message_, name)) value = message_.attr(name).template cast<T>();
  }
  // Without a copy: of NumPy's arrays, and of what gives its memory to others.
  template <typename T>
  void read(const char* name, ArrayView<T>& view) {
    if (!py::hasattr(message_, name)) return;
    py::object values = message_.attr(name);
    if (!py::isinstance<py::array>(values)) {
      values = py::module_::import("numpy").attr("frombuffer")(values, py::dtype::of<T>());
    }
    const auto array = values.cast<Array<T>>();
    view = array;
    arrays_.push_back(array);
  }
  void readPoses() {
    if (!py::hasattr(message_, "poses")) return;
    for (const py::handle pose : message_.attr("poses")) {
      const py::object q = pose.attr("orientation");
      batch_.poses.push_back({pointOf(pose.attr("position")),
                              {number(q, "x"), number(q, "y"), number(q, "z"), number(q, "w")}});
    }
  }
  static double number(const py::object& of, const char* name) {
    return of.attr(name).cast<double>();
  }
  static std::array<double, 3> pointOf(const py::object& point) {
    return {number(point, "x"), number(point, "y"), number(point, "z")};
  }

  py::object message_;
  GaussianBatch batch_;
  std::vector<py::array> arrays_;
};

// Applies a batch to a map's books, and by hold(edit) to what holds its splats.
template <typename Hold>
BatchReport apply(GaussianMap& map, const GaussianBatch& batch, const Hold& hold) {
  BatchReport report;
  map.apply(batch, report, [&](const auto& edit, const MapState&) { hold(*edit); });
  return report;
}

// What is known of a map, by the names of MapState. state(target): its MapState.
template <typename Target, typename... Bases, typename State>
void defineState(py::class_<Target, Bases...>& type, State state) {
  const auto define = [&](const char* name, auto MapState::* field) {
    type.def_property_readonly(name, [=](const Target& target) { return state(target).*field; });
  };
  define("map_id", &MapState::id);
  define("revision", &MapState::revision);
  define("splats", &MapState::splats);
  define("expected", &MapState::expected);
  define("capacity", &MapState::capacity);
  define("groups", &MapState::groups);
  define("missed", &MapState::missed);
  define("dropped", &MapState::dropped);
  define("pulled", &MapState::pulled);
}

// A method `apply` that takes a GaussianArray. take: a function of the target and a batch.
template <typename Target, typename... Bases, typename Take>
void defineApply(py::class_<Target, Bases...>& type, Take take) {
  type.def(
      "apply",
      [take](Target& target, const py::object& batch, Arrival arrival) {
        ReadBatch read(batch);
        read.batch().arrival = arrival;
        BatchReport report;
        {
          const py::gil_scoped_release release;
          report = take(target, read.batch());
        }
        return py::dict("missed"_a = report.missed, "dropped"_a = report.dropped);
      },
      "batch"_a, "arrival"_a = Arrival::kHeard,
      "Applies a rosplat_msgs/GaussianArray, or anything with its fields. Returns \"missed\", the\n"
      "number of batches missed before it, and \"dropped\", that of its splats that were dropped.\n"
      "Raises BatchError, naming the field, for a batch that contradicts itself.");
}

}  // namespace rosplat::python
