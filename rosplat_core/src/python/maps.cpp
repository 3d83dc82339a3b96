// Maps for Python: what a batch does to one, and what a receiver pulls.

#include "python/module.hpp"
#include "rosplat_core/map/map_pull.hpp"
#include "rosplat_core/python/bindings.hpp"

namespace rosplat::python {

namespace {

// At the identity where it was never named.
Group groupOf(const GaussianMap& map, std::uint32_t number) {
  const Group* const group = map.groups().find(number);
  return group ? *group : Group{};
}

// Whatever Python calls a batch, with its label: map_id, revision, whether it replaces, bytes.
using Pull = MapPull<py::object>;
using Labelled = std::tuple<std::string, std::uint64_t, bool, std::size_t, py::object>;

Pull::Labelled labelled(const Labelled& from) {
  const auto& [map_id, revision, replaces, bytes, batch] = from;
  return {{map_id, revision, replaces, bytes}, batch};
}

// The batches to apply, each with how it came, and the request to send, or None.
py::tuple toPython(const Pull::Step& step) {
  py::object request = py::none();
  if (const auto& asked = step.request) {
    request =
        py::make_tuple(asked->number, asked->map_id, asked->after_revision, asked->first_block);
  }
  return py::make_tuple(step.batches, request);
}

}  // namespace

void defineMaps(py::module_& module) {
  py::register_exception<BatchError>(module, "BatchError", PyExc_ValueError);
  py::enum_<Arrival>(module, "Arrival")
      .value("HEARD", Arrival::kHeard)
      .value("PULLED", Arrival::kPulled)
      .value("LAST", Arrival::kLast);
  py::class_<Pull>(module, "MapPull", "What a display pulls of a map, and when; see map_pull.py.")
      .def(py::init<>())
      .def_property_readonly("pulling", &Pull::pulling)
      .def_readwrite("held", &Pull::held)
      .def(
          "miss", [](Pull& pull, const Labelled& heard) { pull.miss(labelled(heard).label); },
          "heard"_a)
      .def("doubt", &Pull::doubt)
      .def(
          "hear",
          [](Pull& pull, const Labelled& heard, double now, bool served) {
            return toPython(pull.hear(labelled(heard), now, served));
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
      .def_property_readonly("revision", [](const GaussianMap& m) { return m.state().revision; })
      .def_property_readonly("splats", [](const GaussianMap& m) { return m.state().splats; })
      .def_property_readonly("missed", [](const GaussianMap& m) { return m.state().missed; })
      .def_property_readonly("pulled", [](const GaussianMap& m) { return m.state().pulled; })
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
      .def_property_readonly("groups", [](const GaussianMap& m) { return m.state().groups; })
      .def_property_readonly("channels",
                             [](const GaussianMap& m) {
                               std::vector<std::string> names;
                               for (const Channel& channel : m.state().channels) {
                                 names.push_back(channel.name);
                               }
                               return names;
                             })
      .def_property_readonly("antialiased",
                             [](const GaussianMap& m) { return m.state().antialiased; });
  defineApply(map, [](GaussianMap& m, const GaussianBatch& batch) {
    BatchReport report;
    m.apply(batch, report);
    return report;
  });
}

}  // namespace rosplat::python
