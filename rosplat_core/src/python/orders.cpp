// Depth orders for Python: how they are found, and how they travel.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "python/module.hpp"
#include "rosplat_core/order/depth_order.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/python/bindings.hpp"

namespace rosplat::python {

namespace {

using Slots = Array<std::uint32_t>;

// Arrays are taken as they are, without a silent copy or cast of a whole map.
using Floats = Array<float>;

Floats floats(const py::handle& object, py::ssize_t size, const char* name) {
  if (!py::isinstance<Floats>(object)) {
    throw py::type_error(std::string(name) + " must be a contiguous float32 array");
  }
  auto array = py::reinterpret_borrow<Floats>(object);
  if (array.size() != size) throw py::value_error(std::string(name) + " has the wrong size");
  return array;
}

// The views of a rosplat_core.view.SortView, one for each group.
std::vector<SortView> toViews(const py::handle& object) {
  SortView view;
  const auto number = [&](const char* name) { return object.attr(name).cast<float>(); };
  const Floats rotations(py::reinterpret_borrow<py::object>(object.attr("rotations")));
  const Floats translations(py::reinterpret_borrow<py::object>(object.attr("translations")));
  const py::ssize_t count = translations.size() / 3;
  if (rotations.size() != 9 * count || translations.size() != 3 * count) {
    throw py::value_error("view.rotations must be n x 3 x 3 and view.translations n x 3");
  }
  view.fx = number("fx");
  view.fy = number("fy");
  view.offset_x = number("offset_x");
  view.offset_y = number("offset_y");
  view.half_width = number("half_width");
  view.half_height = number("half_height");
  view.slope_x = number("slope_x");
  view.slope_y = number("slope_y");
  view.near_clip = number("near_clip");
  view.far_clip = number("far_clip");
  view.orthographic = object.attr("orthographic").cast<bool>();
  std::vector<SortView> views(static_cast<std::size_t>(count), view);
  for (py::ssize_t i = 0; i < count; ++i) {
    std::copy_n(rotations.data() + 9 * i, 9, views[i].rotation);
    std::copy_n(translations.data() + 3 * i, 3, views[i].translation);
  }
  return views;
}

// The pages of a map of so many rows and groups. object: first slot, place and group of each page.
std::vector<SortPage> toPages(const py::handle& object, py::ssize_t rows, std::size_t groups) {
  if (!py::isinstance<Slots>(object)) {
    throw py::type_error("pages must be a contiguous uint32 array");
  }
  const auto table = py::reinterpret_borrow<Slots>(object);
  const py::ssize_t count = table.size() / 3;
  if (table.size() != 3 * count || count * py::ssize_t{SortPage::kSlots} != rows) {
    throw py::value_error("pages has the wrong size");
  }
  std::vector<SortPage> pages;
  for (py::ssize_t i = 0; i < count; ++i) {
    const std::uint32_t* const row = table.data() + 3 * i;
    pages.push_back({row[0], row[1], row[2]});
    if (row[1] >= count) throw py::value_error("pages names a place beyond the last");
    if (row[2] >= groups) throw py::value_error("pages names a group that view has none for");
  }
  return pages;
}

Slots sort(DepthOrder& sorter, const py::object& view_object, const py::object& positions_object,
           const py::object& extents_object, const py::object& pages_object,
           const py::object& allocate) {
  const std::vector<SortView> views = toViews(view_object);
  const auto rows = static_cast<py::ssize_t>(py::len(extents_object));
  const Floats extents = floats(extents_object, rows, "extents");
  const Floats positions = floats(positions_object, 3 * rows, "positions");
  const std::vector<SortPage> pages = toPages(pages_object, rows, views.size());
  const float* const p = positions.data();
  const float* const e = extents.data();
  Slots order;
  {
    const py::gil_scoped_release release;
    sorter.sort(views.data(), p, e, pages.data(), pages.size(), [&](std::size_t total) {
      const py::gil_scoped_acquire acquire;
      const py::object target = allocate(total);
      if (!py::isinstance<Slots>(target) || static_cast<std::size_t>(py::len(target)) != total) {
        throw py::type_error("allocate must return a contiguous uint32 array of the asked size");
      }
      order = py::reinterpret_borrow<Slots>(target);
      return order.mutable_data();
    });
  }
  return order;
}

// A reader for Python. Its arrays reuse the memory of former ones.
class ArrayReader {
 public:
  std::uint64_t key() const { return reader_.key(); }

  Slots read(std::uint8_t encoding, const py::buffer& packed, std::size_t count, unsigned slot_bits,
             const std::string& segment, std::uint64_t generation) {
    const py::buffer_info bytes = packed.request();
    const auto size = static_cast<std::size_t>(bytes.size * bytes.itemsize);
    auto owner = std::make_unique<std::shared_ptr<Order>>(pool_.make());
    std::vector<std::uint32_t>& slots = (*owner)->slots;
    {
      const py::gil_scoped_release release;
      reader_.read(encoding, static_cast<const std::uint8_t*>(bytes.ptr), size, count, slot_bits,
                   segment, generation, slots);
    }
    const py::capsule capsule(owner.release(),
                              [](void* p) { delete static_cast<std::shared_ptr<Order>*>(p); });
    return Slots(static_cast<py::ssize_t>(slots.size()), slots.data(), capsule);
  }

 private:
  OrderReader reader_;
  OrderPool pool_;
};

void pack(const Slots& slots, unsigned bits, const py::buffer& packed) {
  const py::buffer_info bytes = packed.request(true);
  const auto count = static_cast<std::size_t>(slots.size());
  if (bits < 1 || bits > 32 ||
      static_cast<std::size_t>(bytes.size * bytes.itemsize) != packedBytes(count, bits)) {
    throw py::value_error("packed has the wrong size");
  }
  const std::uint32_t* const from = slots.data();
  const py::gil_scoped_release release;
  packSlots(from, count, bits, static_cast<std::uint8_t*>(bytes.ptr));
}

void mark(const py::buffer& segment, std::uint64_t generation) {
  const py::buffer_info bytes = segment.request(true);
  if (static_cast<std::size_t>(bytes.size * bytes.itemsize) < SegmentHeader::kBytes) {
    throw py::value_error("segment has no room for its header");
  }
  markSegment(bytes.ptr, generation);
}

}  // namespace

void defineOrders(py::module_& module) {
  py::class_<DepthOrder>(module, "DepthOrder", "Keeps its workspace and threads between calls.")
      .def(py::init<unsigned>(), "threads"_a = 0,
           "threads: to sort with, 0 for as many as the machine runs at once.")
      .def_property_readonly("threads", &DepthOrder::threads)
      .def(
          "sort", &sort, "view"_a, "positions"_a, "extents"_a, "pages"_a, "allocate"_a,
          "The visible slots back to front, uint32 (m,), in the array that allocate(m) returns.\n\n"
          "view: a rosplat_core.view.SortView. positions: float32 (rows, 3) [m]. extents: float32\n"
          "(rows,) [m], negative for what is never visible. pages: as SortMap.pages, uint32 (p, "
          "3).\n"
          "All contiguous; other types raise TypeError, other sizes ValueError. One thread at a\n"
          "time.");

  py::register_exception<OrderError>(module, "OrderError", PyExc_ValueError);
  py::class_<ArrayReader>(module, "OrderReader", "A viewer's side of SplatOrder.")
      .def(py::init<>())
      .def_property_readonly("key", &ArrayReader::key,
                             "For ViewCamera.segment_key; 0 while no segment can be read.")
      .def("read", &ArrayReader::read, "encoding"_a, "packed"_a, "count"_a, "slot_bits"_a,
           "segment"_a, "generation"_a,
           "The slots, uint32 (count,), of a packed or shared order. Raises OrderError.");
  module.def("pack", &pack, "slots"_a, "bits"_a, "packed"_a,
             "Writes slots, uint32 (n,), as SplatOrder.packed into (n * bits + 7) / 8 bytes.");
  module.def(
      "mark_segment", &mark, "segment"_a, "generation"_a,
      "Writes a segment's generation, after what was written to it before and before what is\n"
      "written next. segment: its mapping.");
}

}  // namespace rosplat::python
