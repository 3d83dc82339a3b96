// Python's door to the renderer: rviz_gaussian_plugin._offscreen.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <memory>
#include <optional>

#include "cpu/cpu_rasterizer.hpp"
#include "map/map_pull.hpp"
#include "map/payload.hpp"
#include "offscreen_renderer.hpp"
#include "rosplat_sorter/payload.hpp"

namespace py = pybind11;
using namespace py::literals;
using namespace rosplat;

namespace {

template <typename T>
using Array = py::array_t<T, py::array::c_style>;

template <typename T>
Array<T> toArray(std::vector<T> values, std::vector<py::ssize_t> shape) {
  auto* owner = new std::vector<T>(std::move(values));
  const py::capsule capsule(owner, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return Array<T>(std::move(shape), owner->data(), capsule);
}

BatchReport take(OffscreenRenderer& renderer, const GaussianBatch& batch) {
  return renderer.scene().apply(batch);
}

// At the identity where it was never named.
Group groupOf(const GaussianMap& map, std::uint32_t number) {
  const Group* const group = map.groups().find(number);
  return group ? *group : Group{};
}

BatchReport take(SplatScene& scene, const GaussianBatch& batch) { return scene.apply(batch); }

BatchReport take(GaussianMap& map, const GaussianBatch& batch) {
  BatchReport report;
  map.apply(batch, report);
  return report;
}

// The splats of a payload: the message's arrays.
py::dict decodePayload(const Array<std::uint8_t>& payload, std::uint32_t count,
                       std::uint8_t sh_degree) {
  GaussianBatch batch;
  batch.revision = 1;
  batch.count = count;
  batch.sh_degree = sh_degree;
  batch.format = payload::kFormat;
  batch.payload = payload;
  if (batch.payload.size != payload::size(count, sh_degree)) {
    throw BatchError("payload has the wrong size");
  }
  DecodedPayload decoded;
  const GaussianBatch splats = decoded.decode(batch);
  const auto copy = [](const ArrayView<float>& values) {
    return Array<float>(static_cast<py::ssize_t>(values.size), values.data);
  };
  return py::dict("positions"_a = copy(splats.positions),
                  "orientations"_a = copy(splats.orientations), "scales"_a = copy(splats.scales),
                  "opacities"_a = copy(splats.opacities), "sh"_a = copy(splats.sh));
}

// A map that the processor alone draws, without OpenGL.
struct CpuRenderer {
  CpuRenderer(unsigned threads, CpuRasterizer::Instructions instructions)
      : CpuRenderer(std::make_shared<rosplat_sorter::ThreadTeam>(threads), instructions) {}
  CpuRenderer(const std::shared_ptr<rosplat_sorter::ThreadTeam>& team,
              CpuRasterizer::Instructions instructions)
      : levels(team), rasterizer(team, instructions) {}

  GaussianMap map;
  HostSlots slots;
  Levels levels;
  DetailControl detail;
  CpuRasterizer rasterizer;
  SplatPicture picture;
  RenderSettings settings;
};

BatchReport take(CpuRenderer& renderer, const GaussianBatch& batch) {
  BatchReport report;
  renderer.map.apply(batch, report, [&](const auto& edit, const MapState&) {
    if (edit->clear) renderer.levels.clear();
    renderer.slots.apply(*edit, 0);
    renderer.levels.mark(renderer.slots, edit->runs);
  });
  return report;
}

// 7 a group: position [m], quaternion x y z w.
std::vector<Pose> posesOf(const Array<double>& values) {
  const ArrayView<double> numbers = values;
  if (numbers.size % 7 != 0) throw BatchError("poses are of 7 numbers each");
  std::vector<Pose> poses(numbers.size / 7);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const double* const pose = &numbers[7 * i];
    poses[i] = {{pose[0], pose[1], pose[2]}, {pose[3], pose[4], pose[5], pose[6]}};
  }
  return poses;
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

// To whatever takes batches.
template <typename Target>
py::dict apply(Target& target, std::uint8_t operation, std::uint32_t first_slot,
               std::uint32_t count, const Array<std::uint32_t>& slots, std::uint8_t sh_degree,
               bool antialiased, const std::array<double, 3>& origin, const Array<float>& positions,
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
  batch.antialiased = antialiased;
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
}

template <typename Target>
void defineApply(py::class_<Target>& type) {
  type.def("apply", &apply<Target>, "operation"_a, "first_slot"_a, "count"_a, "slots"_a,
           "sh_degree"_a, "antialiased"_a, "origin"_a, "positions"_a, "orientations"_a, "scales"_a,
           "opacities"_a, "sh"_a, "map_id"_a, "revision"_a, "expected_slots"_a = 0, "format"_a = "",
           "payload"_a = Array<std::uint8_t>(0), "arrival"_a = Arrival::kHeard, "group"_a = 0,
           "groups"_a = Array<std::uint32_t>(0), "poses"_a = Array<double>(0),
           "channel_names"_a = std::vector<std::string>(), "channels"_a = Array<float>(0));
}

SplatCamera cameraOf(const std::array<double, 3>& position,
                     const std::array<double, 4>& orientation, int projection, double fx, double fy,
                     double cx, double cy, double width, double height, double near_clip,
                     double far_clip) {
  if (projection != 0 && projection != 1) {
    throw std::invalid_argument("projection " + std::to_string(projection) + " is unknown");
  }
  return makeCamera(position, orientation, projection == 1, fx, fy, cx, cy, width, height,
                    near_clip, far_clip);
}

void setCamera(OffscreenRenderer& renderer, const std::string& view_id, std::uint64_t sequence,
               const std::array<double, 3>& position, const std::array<double, 4>& orientation,
               int projection, double fx, double fy, double cx, double cy, double width,
               double height, double near_clip, double far_clip) {
  renderer.setCamera(view_id, sequence,
                     cameraOf(position, orientation, projection, fx, fy, cx, cy, width, height,
                              near_clip, far_clip));
}

// Fills the slots of an order and offers it, without Python's lock: millions take milliseconds.
template <typename Fill>
void offer(OffscreenRenderer& renderer, const std::string& view_id, std::uint64_t sequence,
           const std::string& map_id, std::uint64_t revision, const std::string& source,
           double sort_time, const Fill& fill) {
  const py::gil_scoped_release release;
  const auto order = renderer.scene().newOrder();
  order->view_id = view_id;
  order->sequence = sequence;
  order->map_id = map_id;
  order->revision = revision;
  order->source = source;
  order->sort_time = sort_time;
  fill(*order);
  renderer.scene().offer(order);
}

void setOrder(OffscreenRenderer& renderer, const std::string& view_id, std::uint64_t sequence,
              const std::string& map_id, std::uint64_t revision, const std::string& source,
              double sort_time, const Array<std::uint32_t>& slots) {
  const ArrayView<std::uint32_t> given = slots;
  offer(renderer, view_id, sequence, map_id, revision, source, sort_time, [&](Order& order) {
    rosplat_sorter::checkCount(given.size, renderer.scene().mostSlots(map_id, revision));
    order.slots.assign(given.data, given.data + given.size);
    order.bound = rosplat_sorter::boundOf(given.data, given.size);
  });
}

void readOrder(OffscreenRenderer& renderer, const std::string& view_id, std::uint64_t sequence,
               const std::string& map_id, std::uint64_t revision, const std::string& source,
               double sort_time, std::uint8_t encoding, const py::buffer& packed, std::size_t count,
               unsigned slot_bits, const std::string& segment, std::uint64_t generation) {
  const py::buffer_info bytes = packed.request();
  const auto size = static_cast<std::size_t>(bytes.size * bytes.itemsize);
  offer(renderer, view_id, sequence, map_id, revision, source, sort_time, [&](Order& order) {
    order.bound = renderer.order_reader.read(
        encoding, static_cast<const std::uint8_t*>(bytes.ptr), size, count, slot_bits, segment,
        generation, order.slots, renderer.scene().mostSlots(map_id, revision));
  });
}

py::dict draw(OffscreenRenderer& renderer, const std::string& view_id, bool sort_now) {
  FrameReport report;
  {
    const py::gil_scoped_release release;  // or orders would wait for the frame
    report = renderer.draw(view_id, sort_now);
  }
  return py::dict(
      "splats"_a = report.splats, "error"_a = report.error, "detail_error"_a = report.detail_error,
      "order_source"_a = report.order_source, "order_fresh"_a = report.order_fresh,
      "order_age"_a = report.order_age, "sort_time"_a = report.sort_time,
      "draw_time"_a = report.draw_time, "paint_time"_a = report.paint_time,
      "picture_age"_a = report.picture_age, "camera_off"_a = report.camera_off,
      "rasterizer"_a = report.rasterizer, "profile"_a = report.profile, "map_id"_a = report.map.id,
      "revision"_a = report.map.revision, "map_complete"_a = report.map.complete(),
      "gpu_bytes"_a = renderer.scene().gpuBytes(), "map_bytes"_a = renderer.scene().mapBytes(),
      "levels_bytes"_a = renderer.scene().levelsBytes());
}

py::list readSlots(OffscreenRenderer& renderer, const std::vector<std::uint32_t>& slots) {
  py::list splats;
  for (SplatValues& splat : renderer.scene().readSlots(slots)) {
    const auto floats = static_cast<py::ssize_t>(splat.sh.size());
    splats.append(py::dict(
        "slot"_a = splat.slot, "group"_a = splat.group, "position"_a = splat.position,
        "orientation"_a = splat.orientation, "scale"_a = splat.scale, "opacity"_a = splat.opacity,
        "sh"_a = toArray(std::move(splat.sh), {floats / 3, 3}), "channels"_a = splat.channels));
  }
  return splats;
}

// Has nodes made of all of the map; returns how many there are.
std::size_t merge(CpuRenderer& renderer) {
  renderer.levels.advance(renderer.slots, [] { return false; });
  return renderer.levels.nodes();
}

// A map in a picture.
PictureLayer layerOf(const CpuRenderer& renderer, const SplatCamera& camera) {
  PictureLayer layer;
  layer.slots = &renderer.slots;
  layer.map = &renderer.map.state();
  layer.camera = camera;
  layer.camera.extent_scale = extentScale(renderer.settings);
  layer.settings = renderer.settings;
  return layer;
}

// Whose arrays must outlive it.
PictureRequest requestOf(const CpuRenderer& renderer, const SplatCamera& camera,
                         const std::optional<Array<float>>& scene_depth,
                         const std::optional<Array<float>>& translucent_depth,
                         const std::optional<Array<std::uint32_t>>& order) {
  PictureRequest request;
  request.layers.push_back(layerOf(renderer, camera));
  if (scene_depth) request.scene_depth = *scene_depth;
  if (translucent_depth) request.translucent_depth = *translucent_depth;
  if (order) request.order = *order;
  return request;
}

py::dict drawOnCpu(CpuRenderer& renderer, const SplatCamera& camera, bool mean_depth,
                   const std::optional<Array<float>>& scene_depth,
                   const std::optional<Array<float>>& translucent_depth,
                   const std::optional<Array<std::uint32_t>>& order,
                   const std::vector<CpuRenderer*>& beside) {
  if (order && !beside.empty()) throw std::invalid_argument("an order is of one map alone");
  PictureRequest request = requestOf(renderer, camera, scene_depth, translucent_depth, order);
  for (const CpuRenderer* other : beside) request.layers.push_back(layerOf(*other, camera));
  request.mean_depth = mean_depth;
  SplatPicture& picture = renderer.picture;
  {
    const py::gil_scoped_release release;
    if (!(renderer.settings.drawnDetail() == Detail{}) && !order) {
      merge(renderer);
      PictureLayer& layer = request.layers.front();
      layer.levels = &renderer.levels;
      layer.error = renderer.detail.choose(layer.settings, renderer.levels.samples(), camera,
                                           renderer.slots.index().groups());
    }
    renderer.rasterizer.draw(request, picture);
    PictureLayer& layer = request.layers.front();
    while (layer.levels) {
      const SplatPicture::OfLayer& drawn = picture.layers.front();
      const std::optional<double> error = renderer.detail.drew(drawn.error, drawn.drawn);
      if (!error) break;
      layer.error = *error;
      renderer.rasterizer.draw(request, picture);
    }
  }
  py::dict drawn("splats"_a = picture.layers.front().drawn,
                 "error"_a = picture.layers.front().error,
                 "detail_error"_a = request.layers.front().levels ? renderer.detail.problem() : "",
                 "profile"_a = picture.profile, "bytes"_a = renderer.rasterizer.bytes());
  const auto add = [&](const char* name, const std::vector<float>& values, int channels) {
    if (!values.empty()) drawn[name] = toArray(values, {picture.height, picture.width, channels});
  };
  add("colour", picture.colour, 4);
  add("behind", picture.behind, 4);
  add("nearness", picture.nearness, 2);
  add("depth", picture.depth, 1);
  return drawn;
}

void contributeOnCpu(CpuRenderer& renderer, const SplatCamera& camera, Contributions& sums,
                     const std::optional<Array<float>>& scene_depth) {
  const PictureRequest request = requestOf(renderer, camera, scene_depth, {}, {});
  const py::gil_scoped_release release;
  renderer.rasterizer.contribute(request, sums);
}

Array<std::uint32_t> pickOnCpu(CpuRenderer& renderer, const SplatCamera& camera,
                               const std::optional<Array<float>>& scene_depth) {
  const PictureRequest request = requestOf(renderer, camera, scene_depth, {}, {});
  std::vector<std::uint32_t> picked;
  {
    const py::gil_scoped_release release;
    for (const PickedSplat& splat : renderer.rasterizer.pick(request)) picked.push_back(splat.slot);
  }
  return toArray(std::move(picked), {camera.height, camera.width});
}

// The nodes of a level of a group, by ascending cells: the width of these, their corners [m], and
// values as of splats.
py::dict nodesOf(const CpuRenderer& renderer, int level, std::uint32_t group) {
  const int degree = renderer.slots.shDegree();
  std::vector<double> corners;
  std::vector<float> positions, orientations, scales, opacities, sh;
  const auto add = [](auto& all, const auto& values) {
    all.insert(all.end(), values.begin(), values.end());
  };
  const std::vector<Group>& groups = renderer.slots.index().groups();
  const auto of = std::find_if(groups.begin(), groups.end(),
                               [group](const Group& other) { return other.number == group; });
  const auto index = static_cast<std::size_t>(of - groups.begin());
  static const Levels::Nodes kNone;
  const Levels::Nodes& nodes =
      index < renderer.levels.groups().size() ? renderer.levels.groups()[index] : kNone;
  for (const auto& page : nodes.at(static_cast<std::size_t>(level))) {
    for (std::size_t i = 0; i < page->cells.size(); ++i) {
      const Node node = page->node(i, degree);
      const Splat splat = unpackSlot(node.packed.words.data());
      add(corners, cornerOf(node.cell));
      add(positions, splat.position);
      add(orientations, splat.orientation);
      add(scales, splat.scale);
      opacities.push_back(kMostNodeOpacity * splat.opacity);
      add(sh, splat.color);
      add(sh, unpackHarmonics(node.packed.words.data(), degree, node.packed.bandWords()));
    }
  }
  const auto n = static_cast<py::ssize_t>(opacities.size());
  const py::ssize_t coefficients = (degree + 1) * (degree + 1);
  return py::dict("size"_a = cellSize(level), "corners"_a = toArray(std::move(corners), {n, 3}),
                  "positions"_a = toArray(std::move(positions), {n, 3}),
                  "orientations"_a = toArray(std::move(orientations), {n, 4}),
                  "scales"_a = toArray(std::move(scales), {n, 3}),
                  "opacities"_a = toArray(std::move(opacities), {n}),
                  "sh"_a = toArray(std::move(sh), {n, coefficients, 3}));
}

}  // namespace

PYBIND11_MODULE(_offscreen, module) {
  py::register_exception<BatchError>(module, "BatchError", PyExc_ValueError);
  // Local, for rosplat_sorter's own module has the same error.
  py::register_local_exception<rosplat_sorter::OrderError>(module, "OrderError", PyExc_ValueError);
  py::enum_<Arrival>(module, "Arrival")
      .value("HEARD", Arrival::kHeard)
      .value("PULLED", Arrival::kPulled)
      .value("LAST", Arrival::kLast);
  py::enum_<DrawMode>(module, "DrawMode")
      .value("COLOR", DrawMode::kColor)
      .value("DEPTH", DrawMode::kDepth)
      .value("BILLBOARD", DrawMode::kBillboard)
      .value("FLAT_BALL", DrawMode::kFlatBall)
      .value("GAUSSIAN_BALL", DrawMode::kGaussianBall)
      .value("NORMALS", DrawMode::kNormals)
      .value("OPACITY", DrawMode::kOpacity)
      .value("AGE", DrawMode::kAge)
      .value("CHANNEL", DrawMode::kChannel);
  py::enum_<ChannelColours>(module, "ChannelColours")
      .value("AUTO", ChannelColours::kAuto)
      .value("CATEGORIES", ChannelColours::kCategories)
      .value("GRADIENT", ChannelColours::kGradient);
  py::enum_<Antialiasing>(module, "Antialiasing")
      .value("AS_TRAINED", Antialiasing::kAsTrained)
      .value("ON", Antialiasing::kOn)
      .value("OFF", Antialiasing::kOff);
  py::enum_<OrderSource>(module, "OrderSource")
      .value("AUTO", OrderSource::kAuto)
      .value("SIDECAR", OrderSource::kSidecar)
      .value("BUILT_IN", OrderSource::kBuiltIn)
      .value("OFF", OrderSource::kOff)
      .value("GPU", OrderSource::kGpu);
  py::enum_<Rasterizer>(module, "Rasterizer")
      .value("AUTO", Rasterizer::kAuto)
      .value("QUADS", Rasterizer::kQuads)
      .value("TILES", Rasterizer::kTiles)
      .value("PROCESSOR", Rasterizer::kProcessor);
  py::class_<ClipBox>(module, "ClipBox")
      .def(py::init<>())
      .def_readwrite("enabled", &ClipBox::enabled)
      .def_readwrite("centre", &ClipBox::centre)
      .def_readwrite("size", &ClipBox::size);
  py::class_<RenderSettings>(module, "RenderSettings")
      .def(py::init<>())
      .def_readwrite("mode", &RenderSettings::mode)
      .def_readwrite("max_sh_degree", &RenderSettings::max_sh_degree)
      .def_readwrite("only_band", &RenderSettings::only_band)
      .def_readwrite("float_blending", &RenderSettings::float_blending)
      .def_readwrite("asynchronous", &RenderSettings::asynchronous)
      .def_readwrite("scale", &RenderSettings::scale)
      .def_readwrite("opacity", &RenderSettings::opacity)
      .def_readwrite("antialiasing", &RenderSettings::antialiasing)
      .def_readwrite("order", &RenderSettings::order)
      .def_readwrite("rasterizer", &RenderSettings::rasterizer)
      .def_readwrite("profile", &RenderSettings::profile)
      .def_property(
          "detail", [](const RenderSettings& s) { return toText(s.detail); },
          [](RenderSettings& s, const std::string& text) { s.detail = parseDetail(text); })
      .def_readwrite("clip_box", &RenderSettings::clip_box)
      .def_readwrite("near_fade", &RenderSettings::near_fade)
      .def_readwrite("depth_range", &RenderSettings::depth_range)
      .def_readwrite("age_range", &RenderSettings::age_range)
      .def_readwrite("channel", &RenderSettings::channel)
      .def_readwrite("channel_colours", &RenderSettings::channel_colours)
      .def_readwrite("channel_range", &RenderSettings::channel_range);
  module.def("decode_payload", &decodePayload, "payload"_a, "count"_a, "sh_degree"_a,
             "The arrays of GaussianArray, flat, that a payload stands for. Raises BatchError.");
  py::class_<Pull>(module, "MapPull", "What a display pulls of a map, and when; see map_pull.py.")
      .def(py::init<>())
      .def_property_readonly("pulling", &Pull::pulling)
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
  defineApply(map);
  py::class_<SplatScene> beside(module, "MapBeside", "Another map of a Renderer.");
  defineApply(beside);
  py::class_<OffscreenRenderer> renderer(module, "Renderer");
  defineApply(renderer);
  renderer.def(py::init<const std::string&, const std::string&>(), "media"_a, "plugins"_a)
      .def("add_map", &OffscreenRenderer::addMap, py::return_value_policy::reference_internal)
      .def("set_camera", &setCamera, "view_id"_a, "sequence"_a, "position"_a, "orientation"_a,
           "projection"_a, "fx"_a, "fy"_a, "cx"_a, "cy"_a, "width"_a, "height"_a, "near"_a = 0.01,
           "far"_a = 1e10)
      .def("set_order", &setOrder, "view_id"_a, "sequence"_a, "map_id"_a, "revision"_a, "source"_a,
           "sort_time"_a, "slots"_a)
      .def("read_order", &readOrder, "view_id"_a, "sequence"_a, "map_id"_a, "revision"_a,
           "source"_a, "sort_time"_a, "encoding"_a, "packed"_a, "count"_a, "slot_bits"_a,
           "segment"_a, "generation"_a)
      .def_property_readonly("segment_key",
                             [](OffscreenRenderer& r) { return r.order_reader.key(); })
      .def("set_box", &OffscreenRenderer::setBox, "centre"_a, "size"_a, "opacity"_a = 1.0f)
      .def_readwrite("settings", &OffscreenRenderer::settings)
      .def("wants_orders", [](OffscreenRenderer& r) { return r.scene().wantsOrders(r.settings); })
      .def(
          "has_order",
          [](OffscreenRenderer& r, const std::string& id) {
            return r.scene().answered(id, r.settings);
          },
          "view_id"_a)
      .def("draw", &draw, "view_id"_a, "sort_now"_a = false)
      .def("read_color",
           [](OffscreenRenderer& r) { return toArray(r.readColor(), {r.height(), r.width(), 4}); })
      .def("read_depth",
           [](OffscreenRenderer& r) { return toArray(r.readDepth(), {r.height(), r.width()}); })
      .def(
          "pick",
          [](OffscreenRenderer& r, const std::string& view_id, int left, int top, int width,
             int height) {
            return toArray(r.pick(view_id, left, top, width, height),
                           {std::max(height, 0), std::max(width, 0)});
          },
          "view_id"_a, "left"_a, "top"_a, "width"_a, "height"_a)
      .def("read_slots", &readSlots, "slots"_a)
      .def(
          "read_color8",
          [](OffscreenRenderer& r, const std::array<float, 3>& background) {
            return toArray(r.readPicture(background), {r.height(), r.width(), 3});
          },
          "background"_a = std::array<float, 3>{0, 0, 0})
      .def_property_readonly("map_id", [](OffscreenRenderer& r) { return r.scene().state().id; })
      .def_property_readonly("revision",
                             [](OffscreenRenderer& r) { return r.scene().state().revision; })
      .def_property_readonly("splats",
                             [](OffscreenRenderer& r) { return r.scene().state().splats; })
      .def_property_readonly("expected",
                             [](OffscreenRenderer& r) { return r.scene().state().expected; })
      .def_property_readonly("capacity",
                             [](OffscreenRenderer& r) { return r.scene().state().capacity; })
      .def_property_readonly("dropped",
                             [](OffscreenRenderer& r) { return r.scene().state().dropped; })
      .def_property_readonly("missed",
                             [](OffscreenRenderer& r) { return r.scene().state().missed; })
      .def_property_readonly("groups",
                             [](OffscreenRenderer& r) { return r.scene().state().groups; })
      .def_property_readonly("warning", [](OffscreenRenderer& r) { return r.scene().warning(); })
      .def("failed", &OffscreenRenderer::failed)
      .def_property_readonly("renderer_info", &OffscreenRenderer::graphics);
  py::class_<SplatCamera>(module, "Camera")
      .def(py::init(&cameraOf), "position"_a, "orientation"_a, "projection"_a, "fx"_a, "fy"_a,
           "cx"_a, "cy"_a, "width"_a, "height"_a, "near"_a = 0.01, "far"_a = 1e10)
      .def("crop", &crop, "left"_a, "top"_a, "width"_a, "height"_a)
      .def_readwrite("ndc_scale", &SplatCamera::ndc_scale)
      .def_readwrite("ndc_offset", &SplatCamera::ndc_offset);
  py::enum_<CpuRasterizer::Instructions>(module, "Instructions")
      .value("PLAIN", CpuRasterizer::Instructions::kPlain)
      .value("AVX2", CpuRasterizer::Instructions::kAvx2)
      .value("AVX512", CpuRasterizer::Instructions::kAvx512)
      .value("BEST", CpuRasterizer::Instructions::kBest);
  const auto sums_of = [](const std::vector<float>& values) {
    return Array<float>(static_cast<py::ssize_t>(values.size()), values.data());
  };
  py::class_<Contributions>(module, "Contributions")
      .def(py::init<>())
      .def_property_readonly("weight", [=](const Contributions& c) { return sums_of(c.weight); })
      .def_property_readonly("energy", [=](const Contributions& c) { return sums_of(c.energy); })
      .def_property_readonly("error", [=](const Contributions& c) { return sums_of(c.error); });
  py::class_<CpuRenderer> cpu_renderer(module, "CpuRenderer");
  defineApply(cpu_renderer);
  cpu_renderer
      .def(py::init<unsigned, CpuRasterizer::Instructions>(), "threads"_a = 0,
           "instructions"_a = CpuRasterizer::Instructions::kBest)
      .def_readwrite("settings", &CpuRenderer::settings)
      .def("draw", &drawOnCpu, "camera"_a, "mean_depth"_a = false, "scene_depth"_a = py::none(),
           "translucent_depth"_a = py::none(), "order"_a = py::none(),
           "beside"_a = std::vector<CpuRenderer*>(),
           "Draws the map; and, in one order with it, those of other renderers in the same frame.")
      .def("merge", &merge, py::call_guard<py::gil_scoped_release>())
      .def("nodes", &nodesOf, "level"_a, "group"_a = 0)
      .def_property_readonly("levels_bytes", [](CpuRenderer& r) { return r.levels.bytes(); })
      .def("pick", &pickOnCpu, "camera"_a, "scene_depth"_a = py::none())
      .def("contribute", &contributeOnCpu, "camera"_a, "sums"_a, "scene_depth"_a = py::none())
      .def_property_readonly("map_bytes", [](CpuRenderer& r) { return r.slots.bytes(); })
      .def_property_readonly("instructions",
                             [](CpuRenderer& r) { return r.rasterizer.instructions(); });
}
