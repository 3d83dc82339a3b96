// The offscreen renderer for Python: rviz_gaussian_plugin._offscreen.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>

#include "card_renderer.hpp"
#include "offscreen_renderer.hpp"
#include "rosplat_core/python/bindings.hpp"

using namespace rosplat;
using namespace rosplat::python;
using namespace py::literals;

namespace {

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
    checkCount(given.size, renderer.scene().mostSlots(map_id, revision));
    order.slots.assign(given.data, given.data + given.size);
    order.bound = boundOf(given.data, given.size);
  });
}

// Offers an order that came in a message. Returns a remark for the user, mostly empty.
std::string readOrder(OffscreenRenderer& renderer, const std::string& view_id,
                      std::uint64_t sequence, const std::string& map_id, std::uint64_t revision,
                      const std::string& source, double sort_time, std::uint8_t encoding,
                      const py::buffer& packed, std::size_t count, unsigned slot_bits,
                      const std::string& segment, std::uint64_t generation) {
  const py::buffer_info bytes = packed.request();
  const auto size = static_cast<std::size_t>(bytes.size * bytes.itemsize);
  offer(renderer, view_id, sequence, map_id, revision, source, sort_time, [&](Order& order) {
    order.bound = renderer.order_reader.read(
        encoding, static_cast<const std::uint8_t*>(bytes.ptr), size, count, slot_bits, segment,
        generation, order.slots, renderer.scene().mostSlots(map_id, revision));
  });
  return renderer.order_reader.takeRemark();
}

py::dict draw(OffscreenRenderer& renderer, const std::string& view_id, bool sort_now) {
  FrameReport report;
  {
    const py::gil_scoped_release release;  // so that orders needn't wait for the frame
    report = renderer.draw(view_id, sort_now);
  }
  const DrawnBytes bytes = renderer.scene().bytes();
  return py::dict("splats"_a = report.splats, "error"_a = report.error,
                  "detail_error"_a = report.detail_error, "order_source"_a = report.order_source,
                  "order_fresh"_a = report.order_fresh, "order_age"_a = report.order_age,
                  "sort_time"_a = report.sort_time, "draw_time"_a = report.draw_time,
                  "paint_time"_a = report.paint_time, "picture_age"_a = report.picture_age,
                  "camera_off"_a = report.camera_off, "rasterizer"_a = report.rasterizer,
                  "profile"_a = report.profile, "map_id"_a = report.map.id,
                  "revision"_a = report.map.revision, "map_complete"_a = report.map.complete(),
                  "gpu_bytes"_a = bytes.gpu + bytes.shared_gpu, "map_bytes"_a = bytes.map,
                  "levels_bytes"_a = bytes.levels);
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

py::tuple drawOnCard(CardRenderer& renderer, const SplatCamera& camera, unsigned bodies) {
  Array<std::uint8_t> colours({camera.height, camera.width, 3});
  py::array_t<bool> surfaces({camera.height, camera.width});
  Array<float> depths({camera.height, camera.width});
  const CardRenderer::Memory to{colours.mutable_data(),
                                reinterpret_cast<std::uint8_t*>(surfaces.mutable_data()),
                                depths.mutable_data()};
  {
    const py::gil_scoped_release release;
    renderer.draw(camera, bodies, to);
  }
  return py::make_tuple(std::move(colours), std::move(depths), std::move(surfaces));
}

// A map of a CardRenderer, which lives as long.
struct MapOnCard {
  CardRenderer& renderer;
  CardRenderer::Map& map;
};

}  // namespace

PYBIND11_MODULE(_offscreen, module) {
  py::module_::import("rosplat_core._core");  // defines classes that are used here
  py::class_<SplatScene> beside(module, "MapBeside", "Another map of a Renderer.");
  defineApply(beside,
              [](SplatScene& scene, const GaussianBatch& batch) { return scene.apply(batch); });
  py::class_<OffscreenRenderer> renderer(module, "Renderer");
  defineApply(renderer, [](OffscreenRenderer& r, const GaussianBatch& batch) {
    return r.scene().apply(batch);
  });
  defineState(renderer, [](const OffscreenRenderer& r) { return r.scene().state(); });
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
      .def(
          "has_order",
          [](OffscreenRenderer& r, const std::string& id) { return r.scene().answered(id); },
          "view_id"_a)
      .def(
          "upload", [](OffscreenRenderer& r, bool all) { r.scene().upload(r.settings, all); },
          "all"_a = false, py::call_guard<py::gil_scoped_release>())
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
      .def_property_readonly(
          "sample", [](OffscreenRenderer& r) { return toArray(r.scene().samplePositions()); })
      .def_property_readonly("error", [](OffscreenRenderer& r) { return r.scene().error(); })
      .def_property_readonly("warning", [](OffscreenRenderer& r) { return r.scene().warning(); })
      .def("failed", &OffscreenRenderer::failed)
      .def_property_readonly("renderer_info", &OffscreenRenderer::graphics);

  py::class_<EglContext, std::shared_ptr<EglContext>>(module, "Context",
                                                      "An OpenGL context, current within `with`.")
      .def("__enter__", &EglContext::enter, py::call_guard<py::gil_scoped_release>())
      .def("__exit__", [](EglContext& context, const py::args&) { context.leave(); });
  py::class_<MapOnCard> on_card(module, "MapOnCard", "A map of a CardRenderer.");
  defineApply(on_card, [](MapOnCard& of, const GaussianBatch& batch) {
    return of.renderer.apply(of.map, batch);
  });
  const auto add_map = [](CardRenderer& r) { return MapOnCard{r, r.addMap()}; };
  py::class_<CardRenderer>(module, "CardRenderer")
      .def(py::init<const std::string&>(), "media"_a)
      .def("add_map", add_map, py::keep_alive<0, 1>())
      .def("draw", &drawOnCard, "camera"_a, "bodies"_a = 0)
      .def_readwrite("settings", &CardRenderer::settings)
      .def_property_readonly("context", &CardRenderer::context)
      .def_property_readonly("device", &CardRenderer::graphics);
}
