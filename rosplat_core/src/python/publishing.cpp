// The publisher's side of a map, for Python.

#include <pybind11/functional.h>

#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <variant>

#include "python/held_splats.hpp"
#include "python/module.hpp"
#include "rosplat_core/map/published_map.hpp"

namespace rosplat::python {

namespace {

using Batch = PublishedMap::Batch;
using Time = std::optional<std::pair<std::int32_t, std::uint32_t>>;
using PoseValues = std::array<double, 7>;  // position x y z, quaternion x y z w

PublishedMap::When whenOf(const Time& time) {
  if (!time) return std::nullopt;
  return Stamp(time->first, time->second);
}

// Keeps the arrays beyond the call. Any thread may release them: that takes Python's lock.
std::shared_ptr<const void> keeperOf(HeldSplats&& splats) {
  return {new HeldSplats(std::move(splats)), [](const HeldSplats* held) {
            const py::gil_scoped_acquire gil;
            delete held;
          }};
}

PublishedMap::Slots listOf(const Array<std::uint32_t>& slots) {
  return {slots.data(), slots.data() + slots.size()};
}

PoseValues valuesOf(const Pose& pose) {
  const auto& [p, q] = std::tie(pose.position, pose.orientation);
  return {p[0], p[1], p[2], q[0], q[1], q[2], q[3]};
}

std::map<std::uint32_t, PoseValues> valuesOf(const PublishedMap::Poses& poses) {
  std::map<std::uint32_t, PoseValues> values;
  for (const auto& [group, pose] : poses) values[group] = valuesOf(pose);
  return values;
}

// A view of a batch's array.
template <typename T>
Array<T> arrayOf(const py::object& batch, const std::vector<T>& values) {
  return Array<T>(static_cast<py::ssize_t>(values.size()), values.data(), batch);
}

template <typename T>
void defineField(py::class_<Batch>& type, const char* name, T BatchHead::* value) {
  type.def_readonly(name, value);
}

template <typename T>
void defineField(py::class_<Batch>& type, const char* name, std::vector<T> Batch::* values) {
  type.def_property_readonly(name, [values](const py::object& self) {
    return arrayOf(self, self.cast<const Batch&>().*values);
  });
}

void defineBatch(py::module_& module) {
  py::class_<Batch> type(module, "PublishedBatch", "The fields of a GaussianArray, flat.");
  py::list names;
#define DEFINE(field)                       \
  defineField(type, #field, &Batch::field); \
  names.append(#field);
  ROSPLAT_BATCH_FIELDS(DEFINE)
#undef DEFINE
  type.attr("FIELDS") = py::tuple(names);
  type.def_readonly("origin", &Batch::origin)
      .def_property_readonly("poses", [](const Batch& batch) { return valuesOf(batch.poses); })
      .def_property_readonly("stamp", [](const Batch& batch) -> Time {
        if (!batch.stamp) return std::nullopt;
        return std::pair(batch.stamp->sec, batch.stamp->nanosec);
      });
}

std::unique_ptr<PublishedMap> makeMap(std::size_t chunk_bytes, const std::string& compression,
                                      std::function<void(Batch&&)> send,
                                      std::function<void(const std::string&)> warn,
                                      std::function<void()> settle) {
  PublishedMap::Wire wire{std::move(send), std::move(warn), std::move(settle)};
  return std::make_unique<PublishedMap>(chunk_bytes, compression, std::move(wire));
}

// A group's number, its pose if it was placed, its slots, and the arguments of Splats.
py::tuple toPython(PublishedMap::Group&& group) {
  const auto n = static_cast<py::ssize_t>(group.slots.size());
  Splats& splats = group.splats;
  py::dict channels;
  for (auto& [name, values] : splats.channels) channels[py::str(name)] = toArray(values, {n});
  py::object pose = py::none();
  if (group.pose) pose = py::cast(valuesOf(*group.pose));
  const std::vector<double> origin(splats.origin.begin(), splats.origin.end());
  const int model = int(splats.model);
  py::dict arguments = arraysOf(std::move(splats));
  arguments["origin"] = toArray(origin, {3});
  arguments["model"] = model;
  arguments["channels"] = channels;
  return py::make_tuple(group.number, pose, toArray(std::move(group.slots), {n}), arguments);
}

}  // namespace

void definePublishing(py::module_& module) {
  const py::call_guard<py::gil_scoped_release> free;  // sending takes the lock again
  defineBatch(module);
  py::class_<PublishedMap>(module, "PublishedMap", "See published_map.hpp.")
      .def(py::init(&makeMap), "chunk_bytes"_a, "compression"_a, "send"_a, "warn"_a, "settle"_a)
      .def_property_readonly("map_id", &PublishedMap::mapId)
      .def("revision", &PublishedMap::revision, free)
      .def("__len__", &PublishedMap::size, free)
      .def("groups",
           [](const PublishedMap& map) {
             std::vector<PublishedMap::Group> groups;
             {
               const py::gil_scoped_release free;
               groups = map.groups();
             }
             py::list copies;
             for (PublishedMap::Group& group : groups) copies.append(toPython(std::move(group)));
             return copies;
           })
      .def("poses",
           [](const PublishedMap& map) {
             PublishedMap::Poses poses;
             {
               const py::gil_scoped_release free;
               poses = map.poses();
             }
             return valuesOf(poses);
           })
      .def(
          "copy",
          [](const PublishedMap& map, const Array<std::uint32_t>& slots, std::uint32_t group) {
            const auto list = listOf(slots);
            const py::gil_scoped_release free;
            return map.copy(list, group);
          },
          "slots"_a, "group"_a)
      .def(
          "replace",
          [](PublishedMap& map, const py::object& splats, std::optional<std::uint32_t> expected,
             const Time& stamp) {
            HeldSplats held(splats);
            const SplatsView view = held.view;
            const auto keeper = view.rows ? keeperOf(std::move(held)) : nullptr;
            const py::gil_scoped_release free;
            map.replace(view, keeper, expected, whenOf(stamp));
          },
          "splats"_a, "expected"_a, "stamp"_a)
      .def("repeat", &PublishedMap::repeat, free)
      .def("expect", &PublishedMap::expect, "slots"_a, free)
      .def(
          "upsert",
          [](PublishedMap& map, const std::variant<std::uint32_t, Array<std::uint32_t>>& slots,
             const py::object& splats, std::uint32_t group, const Time& stamp) {
            const HeldSplats held(splats);
            if (const auto* const first = std::get_if<std::uint32_t>(&slots)) {
              const py::gil_scoped_release free;
              map.upsert(*first, held.view, group, whenOf(stamp));
            } else {
              const auto list = listOf(std::get<1>(slots));
              const py::gil_scoped_release free;
              map.upsert(list, held.view, group, whenOf(stamp));
            }
          },
          "slots"_a, "splats"_a, "group"_a, "stamp"_a)
      .def(
          "append",
          [](PublishedMap& map, const py::object& splats, std::uint32_t group, const Time& stamp) {
            const HeldSplats held(splats);
            PublishedMap::Slots slots;
            {
              const py::gil_scoped_release free;
              slots = map.append(held.view, group, whenOf(stamp));
            }
            const auto n = static_cast<py::ssize_t>(slots.size());
            return toArray(std::move(slots), {n});
          },
          "splats"_a, "group"_a, "stamp"_a)
      .def(
          "erase",
          [](PublishedMap& map, const Array<std::uint32_t>& slots, const Time& stamp) {
            const auto list = listOf(slots);
            const py::gil_scoped_release free;
            map.erase(list, whenOf(stamp));
          },
          "slots"_a, "stamp"_a)
      .def(
          "erase_from",
          [](PublishedMap& map, std::uint32_t first_slot, std::uint32_t count, const Time& stamp) {
            map.erase(first_slot, count, whenOf(stamp));
          },
          "first_slot"_a, "count"_a, "stamp"_a, free)
      .def(
          "move",
          [](PublishedMap& map, const std::map<std::uint32_t, PoseValues>& values,
             const Time& stamp) {
            PublishedMap::Poses poses;
            for (const auto& [group, v] : values) {
              poses[group] = {{v[0], v[1], v[2]}, {v[3], v[4], v[5], v[6]}};
            }
            map.move(poses, whenOf(stamp));
          },
          "poses"_a, "stamp"_a, free)
      .def("pull", [](const PublishedMap& map, const std::string& map_id,
                      std::uint64_t after_revision, std::uint32_t first_block, int most_sh_degree) {
        PublishedMap::Answer answer;
        {
          const py::gil_scoped_release free;
          answer = map.pull(map_id, after_revision, first_block, most_sh_degree);
        }
        py::list batches;
        for (Batch& batch : answer.batches) batches.append(std::move(batch));
        return py::make_tuple(batches, answer.next_block);
      });
}

}  // namespace rosplat::python
