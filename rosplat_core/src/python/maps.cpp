// Maps for Python: what a batch does to one, and what a receiver pulls.

#include "python/module.hpp"
#include "rosplat_core/map/map_pull.hpp"
#include "rosplat_core/map/map_qos.hpp"
#include "rosplat_core/order/splat_rows.hpp"
#include "rosplat_core/python/bindings.hpp"

namespace rosplat::python {

namespace {

// A map's group; one at the identity if none of that number was ever named.
Group groupOf(const GaussianMap& map, std::uint32_t number) {
  const Group* const group = map.groups().find(number);
  return group ? *group : Group{};
}

// A map as sorting needs it: harmonics are checked, and not kept.
struct SortMap : GaussianMap {
  SortMap() : GaussianMap(0) {}

  SplatRows rows;
  SplatRows::Runs changed;  // by the last batch
};

// A view of what a map holds.
template <typename T>
Array<T> viewOf(const py::object& map, const T* values, std::vector<py::ssize_t> shape) {
  return Array<T>(std::move(shape), values, map);
}

// By group index: the matrix that takes positions, as the rows have them, into the map's frame.
Array<double> framesOf(const SortMap& map) {
  const std::vector<Group>& groups = map.rows.pages().groups();
  std::vector<double> frames;
  frames.reserve(16 * groups.size());
  for (const Group& group : groups) {
    const std::array<double, 3> origin = group.place(group.originOrZero());
    for (std::size_t row = 0; row < 3; ++row) {
      const double* const rotation = &group.place.rotation[3 * row];
      frames.insert(frames.end(), {rotation[0], rotation[1], rotation[2], origin[row]});
    }
    frames.insert(frames.end(), {0, 0, 0, 1});
  }
  return toArray(std::move(frames), {static_cast<py::ssize_t>(groups.size()), 4, 4});
}

// First slot, place and group of each page, by ascending slots.
Array<std::uint32_t> pagesOf(const SortMap& map) {
  std::vector<std::uint32_t> table;
  for (const SlotPage& page : map.rows.pages().pages()) {
    table.insert(table.end(), {page.first_slot, page.place, page.group});
  }
  const auto pages = static_cast<py::ssize_t>(table.size() / 3);
  return toArray(std::move(table), {pages, 3});
}

Array<std::int64_t> changedOf(const SortMap& map) {
  std::vector<std::int64_t> runs;
  for (const auto& [first, count] : map.changed) {
    runs.insert(runs.end(), {static_cast<std::int64_t>(first), static_cast<std::int64_t>(count)});
  }
  return toArray(std::move(runs), {static_cast<py::ssize_t>(map.changed.size()), 2});
}

// A batch, any Python object, behind its label: map_id, revision, whether it replaces, bytes.
using Pull = MapPull<py::object>;
using Labelled = std::tuple<std::string, std::uint64_t, bool, std::size_t, py::object>;

Pull::Labelled labelled(const Labelled& from) {
  const auto& [map_id, revision, replaces, bytes, batch] = from;
  return {{map_id, revision, replaces, bytes}, batch};
}

// The batches to apply, each with its Arrival, the request to send, or None, and whether to
// subscribe and to join anew.
py::tuple toPython(const Pull::Step& step) {
  py::object request = py::none();
  if (const auto& asked = step.request) {
    request =
        py::make_tuple(asked->number, asked->map_id, asked->after_revision, asked->first_block);
  }
  return py::make_tuple(step.batches, request, step.subscribe_anew, step.join_anew);
}

// As MapQos has it: reliable, transient local, depth.
using Qos = std::tuple<bool, bool, std::size_t>;

MapQos qosOf(const Qos& from) {
  const auto& [reliable, transient_local, depth] = from;
  return {reliable, transient_local, depth};
}

}  // namespace

void defineMaps(py::module_& module) {
  py::register_exception<BatchError>(module, "BatchError", PyExc_ValueError);
  py::enum_<Arrival>(module, "Arrival")
      .value("HEARD", Arrival::kHeard)
      .value("PULLED", Arrival::kPulled)
      .value("LAST", Arrival::kLast);
  module.def(
      "choose_map_qos",
      [](const Qos& wished, const std::vector<Qos>& offers, bool served) {
        std::vector<MapQos> offered;
        for (const Qos& offer : offers) offered.push_back(qosOf(offer));
        const MapQosChoice choice = chooseMapQos(qosOf(wished), offered, served);
        const Qos qos(choice.qos.reliable, choice.qos.transient_local, choice.qos.depth);
        return std::tuple(qos, choice.best_effort_unheard, choice.volatile_unheard);
      },
      "wished"_a, "offers"_a, "served"_a,
      "What a subscription to a map asks for, and whether it then hears no best effort publisher, "
      "and no volatile one. Each QoS: reliable, transient local, depth.");
  py::class_<Pull>(module, "MapPull", "What a receiver pulls of a map, and when.")
      .def(py::init<>())
      .def_property_readonly("pulling", &Pull::pulling)
      .def_readwrite("held", &Pull::held)
      .def(
          "miss",
          [](Pull& pull, const Labelled& heard, double now) {
            pull.miss(labelled(heard).label, now);
          },
          "heard"_a, "now"_a)
      .def("subscribed_anew", &Pull::subscribedAnew, "now"_a)
      .def("restart", &Pull::restart, "now"_a)
      .def("awaits", &Pull::awaits, "number"_a)
      .def(
          "receive",
          [](Pull& pull, const Labelled& heard, double now, bool served) {
            return toPython(pull.receive(labelled(heard), now, served));
          },
          "heard"_a, "now"_a, "served"_a)
      .def(
          "answer",
          [](Pull& pull, std::uint64_t number, const std::vector<Labelled>& batches,
             std::uint32_t next_block, double now, bool served) {
            std::vector<Pull::Labelled> answer;
            for (const Labelled& each : batches) answer.push_back(labelled(each));
            return toPython(pull.answer(number, std::move(answer), next_block, now, served));
          },
          "number"_a, "batches"_a, "next_block"_a, "now"_a, "served"_a)
      .def(
          "tick",
          [](Pull& pull, double now, bool served) { return toPython(pull.tick(now, served)); },
          "now"_a, "served"_a);
  py::class_<GaussianMap> map(module, "GaussianMap", "A map's books, without what draws it.");
  map.def(py::init<>())
      .def("in_use", &GaussianMap::inUse, "slot"_a)
      .def_property_readonly("complete", [](const GaussianMap& m) { return m.state().complete(); })
      .def(
          "origin",
          [](const GaussianMap& m, std::uint32_t group) { return groupOf(m, group).origin; },
          "group"_a = 0, "Of a group's positions, None where it never had splats. [m]")
      .def(
          "pose",
          [](const GaussianMap& m, std::uint32_t group) {
            const Pose pose = groupOf(m, group).pose;
            return std::pair(pose.position, pose.orientation);
          },
          "group"_a, "Where a group is: position [m], quaternion x y z w.")
      .def_property_readonly("channels",
                             [](const GaussianMap& m) {
                               std::vector<std::string> names;
                               for (const Channel& channel : m.state().channels) {
                                 names.push_back(channel.name);
                               }
                               return names;
                             })
      .def_property_readonly(
          "sample", [](const GaussianMap& m) { return toArray(m.samplePositions()); },
          "Where some thousand splats are, whatever its size, in its frame, float64 (n, 3). [m]")
      .def_property_readonly("model", [](const GaussianMap& m) { return int(m.state().model); });
  defineState(map, [](const GaussianMap& m) -> const MapState& { return m.state(); });
  defineApply(map, [](GaussianMap& m, const GaussianBatch& batch) {
    return apply(m, batch, [](const GaussianEdit&) {});
  });
  py::class_<SortMap, GaussianMap> sorted(module, "SortMap",
                                          "A map as sorting needs it. What it holds may be looked "
                                          "at until the next batch.");
  sorted.def(py::init<>())
      .def_property_readonly(
          "positions",
          [](const py::object& self) {
            const auto& rows = self.cast<const SortMap&>().rows;
            return viewOf(self, rows.positions(), {static_cast<py::ssize_t>(rows.size()), 3});
          },
          "By row, relative to the group's origin, float32 (rows, 3) [m].")
      .def_property_readonly(
          "extents",
          [](const py::object& self) {
            const auto& rows = self.cast<const SortMap&>().rows;
            return viewOf(self, rows.extents(), {static_cast<py::ssize_t>(rows.size())});
          },
          "By row, float32 (rows,) [m]; negative where nothing can be seen.")
      .def_property_readonly("pages", &pagesOf,
                             "First slot, place and group of each page, by slots, uint32 (p, 3).")
      .def_property_readonly(
          "frames", &framesOf,
          "By group, from what positions are relative to into the map's frame, float64 (g, 4, 4).")
      .def_property_readonly("changed", &changedOf,
                             "Runs of rows that the last batch changed: first, count.");
  defineApply(sorted, [](SortMap& m, const GaussianBatch& batch) {
    return apply(m, batch, [&m](const GaussianEdit& edit) { m.changed = m.rows.apply(edit); });
  });
}

}  // namespace rosplat::python
