// Splats in other forms than arrays of floats, for Python: payloads, and rows of packed slots.

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

#include "python/held_splats.hpp"
#include "python/module.hpp"
#include "rosplat_core/slots/payload_format.hpp"

namespace rosplat::python {

namespace {

// The arrays of a rosplat_core.payload.Arrays, and which splats are usable.
struct HeldPayload : HeldArrays {
  std::vector<bool> usable;

  HeldPayload(const py::object& given, const Array<bool>& of)
      : HeldArrays(static_cast<std::size_t>(of.size())), usable(of.data(), of.data() + of.size()) {
    read(given);
  }
};

Array<std::uint8_t> encode(const py::object& arrays, const Array<bool>& usable) {
  const HeldPayload held(arrays, usable);
  std::vector<std::uint8_t> bytes(payload::size(held.arrays.count, held.arrays.sh_degree));
  {
    const py::gil_scoped_release free;
    payload::encode(held.arrays, held.usable, bytes.data());
  }
  const auto size = static_cast<py::ssize_t>(bytes.size());
  return toArray(std::move(bytes), {size});
}

bool suits(const py::object& arrays, const Array<bool>& usable) {
  const HeldPayload held(arrays, usable);
  const py::gil_scoped_release free;
  return payload::suits(held.arrays, held.usable);
}

py::dict decode(const Array<std::uint8_t>& bytes, std::size_t count, int sh_degree,
                const std::string& format) {
  const PayloadFormat known = payloadFormat(format);
  if (sh_degree < 0 || sh_degree > kMaxShDegree) {
    throw std::invalid_argument("sh_degree is " + std::to_string(sh_degree) + ", not 0 to " +
                                std::to_string(kMaxShDegree));
  }
  const std::size_t expected = known.size(count, sh_degree);
  if (static_cast<std::size_t>(bytes.size()) != expected) {
    throw std::invalid_argument("payload has " + std::to_string(bytes.size()) + " bytes, " +
                                std::to_string(expected) + " expected of " + format);
  }
  Splats splats;
  {
    const py::gil_scoped_release free;
    known.decode(bytes.data(), splats.resize(count, sh_degree));
  }
  return arraysOf(std::move(splats));
}

// Rows (n, 8 + (degree + 1)^2) as packed_slot.hpp has them; zero where a splat isn't usable.
Array<std::uint32_t> pack(const py::object& arrays, const Array<bool>& usable) {
  const HeldPayload held(arrays, usable);
  const SplatArrays<const float>& from = held.arrays;
  const int words = rowWords(from.sh_degree);
  Array<std::uint32_t> rows({static_cast<py::ssize_t>(from.count), py::ssize_t{words}});
  std::uint32_t* row = rows.mutable_data();
  const py::gil_scoped_release free;
  for (std::size_t i = 0; i < from.count; ++i, row += words) {
    std::fill_n(row, words, 0u);
    if (!held.usable[i]) continue;
    const float* const sh = from.sh + from.shStride() * i;
    packSlot(splatAt(from, i), sh + 3, from.sh_degree, row, bandsOf(row));
  }
  return rows;
}

// Permutes the rows of an array in place: row order[i] becomes row i.
void putInOrder(py::array& array, const Array<std::int64_t>& order) {
  const auto n = static_cast<std::size_t>(order.size());
  if (n == 0) return;
  if (static_cast<std::size_t>(array.shape(0)) != n || !(array.flags() & py::array::c_style)) {
    throw std::invalid_argument("array: expected a contiguous one, as long as its order");
  }
  const std::size_t bytes = static_cast<std::size_t>(array.nbytes()) / n;
  auto* const rows = static_cast<char*>(array.mutable_data());
  const std::int64_t* const from = order.data();
  const py::gil_scoped_release free;
  std::vector<bool> done(n);
  std::vector<char> first(bytes);
  for (std::size_t start = 0; start < n; ++start) {
    if (done[start]) continue;
    std::memcpy(first.data(), rows + bytes * start, bytes);
    for (std::size_t i = start;;) {
      const auto next = static_cast<std::size_t>(from[i]);
      if (next >= n || done[next]) throw std::invalid_argument("order: no permutation");
      done[next] = true;
      if (next == start) {
        std::memcpy(rows + bytes * i, first.data(), bytes);
        break;
      }
      std::memcpy(rows + bytes * i, rows + bytes * next, bytes);
      i = next;
    }
  }
}

}  // namespace

void definePayloads(py::module_& module) {
  module.def("encode_payload", &encode, "arrays"_a, "usable"_a);
  module.def("payload_suits", &suits, "arrays"_a, "usable"_a);
  module.def("decode_payload", &decode, "payload"_a, "count"_a, "sh_degree"_a, "format"_a);
  module.def("pack_splats", &pack, "arrays"_a, "usable"_a);
  module.def("put_in_order", &putInOrder, "array"_a, "order"_a);
  module.def("payload_size", &payload::size, "count"_a, "sh_degree"_a);
}

}  // namespace rosplat::python
