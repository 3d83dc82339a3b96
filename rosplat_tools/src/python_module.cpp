// For tests: the C++ map, called from Python as the one in Python is.

#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "rosplat_tools/published_map.hpp"

namespace py = pybind11;
using namespace py::literals;

namespace {

using rosplat::PublishedMap;
using Batch = PublishedMap::Batch;
using Array = py::array_t<float, py::array::c_style | py::array::forcecast>;

std::vector<float> flat(const Array& array) { return {array.data(), array.data() + array.size()}; }

template <typename Values>
py::array toPython(const Values& values) {
  return py::array_t<typename Values::value_type>(static_cast<py::ssize_t>(values.size()),
                                                  values.data());
}

using Pose = std::array<double, 7>;  // position x y z, quaternion x y z w

Pose toPython(const PublishedMap::Pose& pose) {
  const auto& p = pose.position;
  const auto& q = pose.orientation;
  return {p.x, p.y, p.z, q.x, q.y, q.z, q.w};
}

PublishedMap::Pose fromPython(const Pose& values) {
  PublishedMap::Pose pose;
  auto& p = pose.position;
  auto& q = pose.orientation;
  std::tie(p.x, p.y, p.z, q.x, q.y, q.z, q.w) = std::tuple_cat(values);
  return pose;
}

// The fields of a message.
py::dict toPython(const Batch& batch) {
  std::vector<Pose> poses;
  for (const PublishedMap::Pose& pose : batch.poses) poses.push_back(toPython(pose));
  const auto& stamp = batch.header.stamp;
  const auto& origin = batch.origin;
  return py::dict(
      "frame_id"_a = batch.header.frame_id, "stamp"_a = py::make_tuple(stamp.sec, stamp.nanosec),
      "map_id"_a = batch.map_id, "revision"_a = batch.revision, "operation"_a = batch.operation,
      "expected_slots"_a = batch.expected_slots, "first_slot"_a = batch.first_slot,
      "count"_a = batch.count, "slots"_a = toPython(batch.slots), "group"_a = batch.group,
      "groups"_a = toPython(batch.groups), "poses"_a = poses, "sh_degree"_a = batch.sh_degree,
      "format"_a = batch.format, "payload"_a = toPython(batch.payload),
      "antialiased"_a = batch.antialiased,
      "origin"_a = py::make_tuple(origin.x, origin.y, origin.z),
      "positions"_a = toPython(batch.positions), "orientations"_a = toPython(batch.orientations),
      "scales"_a = toPython(batch.scales), "opacities"_a = toPython(batch.opacities),
      "sh"_a = toPython(batch.sh), "channel_names"_a = batch.channel_names,
      "channels"_a = toPython(batch.channels));
}

PublishedMap::Stamp stampOf(const std::optional<std::pair<std::int32_t, std::uint32_t>>& time) {
  if (!time) return std::nullopt;
  builtin_interfaces::msg::Time stamp;
  std::tie(stamp.sec, stamp.nanosec) = *time;
  return stamp;
}

std::unique_ptr<PublishedMap> makeMap(const std::string& frame_id, std::size_t chunk_bytes,
                                      const std::string& compression,
                                      std::function<void(py::dict)> send,
                                      std::function<std::pair<std::int32_t, std::uint32_t>()> now,
                                      std::function<void(const std::string&)> warn) {
  rosplat::MapOptions options;
  options.frame_id = frame_id;
  options.chunk_bytes = chunk_bytes;
  options.compression = compression;
  PublishedMap::Wire wire;
  wire.send = [send = std::move(send)](std::unique_ptr<Batch> batch) {
    const py::gil_scoped_acquire gil;
    send(toPython(*batch));
  };
  wire.now = [now = std::move(now)] {
    const py::gil_scoped_acquire gil;
    return *stampOf(now());
  };
  wire.warn = [warn = std::move(warn)](const std::string& text) {
    const py::gil_scoped_acquire gil;
    warn(text);
  };
  return std::make_unique<PublishedMap>(options, std::move(wire));
}

}  // namespace

PYBIND11_MODULE(_published_map, module) {
  using Stamp = std::optional<std::pair<std::int32_t, std::uint32_t>>;
  const py::call_guard<py::gil_scoped_release> free;  // what is sent takes it again

  py::class_<rosplat::Splats>(module, "Splats")
      .def(py::init([](const Array& positions, const Array& orientations, const Array& scales,
                       const Array& opacities, const Array& sh, const std::array<double, 3>& origin,
                       bool antialiased,
                       const std::vector<std::pair<std::string, Array>>& channels) {
             rosplat::Splats splats;
             splats.positions = flat(positions);
             splats.orientations = flat(orientations);
             splats.scales = flat(scales);
             splats.opacities = flat(opacities);
             splats.sh = flat(sh);
             splats.origin = origin;
             splats.antialiased = antialiased;
             for (const auto& [name, values] : channels) {
               splats.channels.emplace_back(name, flat(values));
             }
             return splats;
           }),
           "positions"_a, "orientations"_a, "scales"_a, "opacities"_a, "sh"_a, "origin"_a,
           "antialiased"_a, "channels"_a)
      .def_static("from_trained",
                  [](const Array& means, const Array& quaternions_wxyz, const Array& log_scales,
                     const Array& logits, const Array& sh0, const Array& shN) {
                    return rosplat::Splats::fromTrained(flat(means), flat(quaternions_wxyz),
                                                        flat(log_scales), flat(logits), flat(sh0),
                                                        flat(shN));
                  })
      .def_readonly("origin", &rosplat::Splats::origin)
      .def_readonly("antialiased", &rosplat::Splats::antialiased)
      .def_property_readonly("arrays", [](const rosplat::Splats& splats) {
        py::dict channels;
        for (const auto& [name, values] : splats.channels)
          channels[name.c_str()] = toPython(values);
        return py::dict("positions"_a = toPython(splats.positions),
                        "orientations"_a = toPython(splats.orientations),
                        "scales"_a = toPython(splats.scales),
                        "opacities"_a = toPython(splats.opacities), "sh"_a = toPython(splats.sh),
                        "channels"_a = channels);
      });

  py::class_<PublishedMap>(module, "PublishedMap")
      .def(py::init(&makeMap), "frame_id"_a, "chunk_bytes"_a, "compression"_a, "send"_a, "now"_a,
           "warn"_a)
      .def_property_readonly("map_id", &PublishedMap::mapId)
      .def("revision", &PublishedMap::revision, free)
      .def("__len__", &PublishedMap::size, free)
      .def("groups",
           [](const PublishedMap& map) {
             std::vector<std::tuple<std::uint32_t, PublishedMap::Slots, rosplat::Splats>> groups;
             for (PublishedMap::Group& group : map.groups()) {
               groups.emplace_back(group.number, std::move(group.slots), std::move(group.splats));
             }
             return groups;
           })
      .def("poses",
           [](const PublishedMap& map) {
             std::map<std::uint32_t, Pose> poses;
             for (const auto& [group, pose] : map.poses()) poses[group] = toPython(pose);
             return poses;
           })
      .def(
          "replace",
          [](PublishedMap& map, const rosplat::Splats& splats,
             std::optional<std::uint32_t> expected_slots,
             const Stamp& stamp) { map.replace(splats, expected_slots, stampOf(stamp)); },
          "splats"_a, "expected_slots"_a, "stamp"_a, free)
      .def("repeat", &PublishedMap::repeat, free)
      .def("expect", &PublishedMap::expect, free)
      .def(
          "upsert",
          [](PublishedMap& map, const PublishedMap::Slots& slots, const rosplat::Splats& splats,
             std::uint32_t group,
             const Stamp& stamp) { map.upsert(slots, splats, group, stampOf(stamp)); },
          "slots"_a, "splats"_a, "group"_a, "stamp"_a, free)
      .def(
          "upsert_from",
          [](PublishedMap& map, std::uint32_t first_slot, const rosplat::Splats& splats,
             std::uint32_t group,
             const Stamp& stamp) { map.upsert(first_slot, splats, group, stampOf(stamp)); },
          "first_slot"_a, "splats"_a, "group"_a, "stamp"_a, free)
      .def(
          "erase",
          [](PublishedMap& map, const PublishedMap::Slots& slots, const Stamp& stamp) {
            map.erase(slots, stampOf(stamp));
          },
          "slots"_a, "stamp"_a, free)
      .def(
          "erase_from",
          [](PublishedMap& map, std::uint32_t first_slot, std::uint32_t count, const Stamp& stamp) {
            map.erase(first_slot, count, stampOf(stamp));
          },
          "first_slot"_a, "count"_a, "stamp"_a, free)
      .def(
          "move",
          [](PublishedMap& map, const std::map<std::uint32_t, Pose>& values, const Stamp& stamp) {
            PublishedMap::Poses poses;
            for (const auto& [group, pose] : values) poses[group] = fromPython(pose);
            map.move(poses, stampOf(stamp));
          },
          "poses"_a, "stamp"_a, free)
      .def("pull", [](const PublishedMap& map, const std::string& map_id,
                      std::uint64_t after_revision, std::uint32_t first_block) {
        PublishedMap::PullMap::Request request;
        request.map_id = map_id;
        request.after_revision = after_revision;
        request.first_block = first_block;
        PublishedMap::PullMap::Response response;
        {
          const py::gil_scoped_release free;
          response = map.pull(request);
        }
        py::list batches;
        for (const Batch& batch : response.batches) batches.append(toPython(batch));
        return py::make_tuple(batches, response.next_block);
      });
}
