#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "rosplat_core/map/groups.hpp"

namespace rosplat {

// A contiguous array owned by someone else.
template <typename T>
struct ArrayView {
  ArrayView() = default;
  template <typename Array, typename = std::enable_if_t<std::is_convertible_v<
                                decltype(std::declval<const Array&>().data()), const T*>>>
  ArrayView(const Array& array)
      : data(array.data()), size(static_cast<std::size_t>(array.size())) {}

  const T* data = nullptr;
  std::size_t size = 0;

  const T& operator[](std::size_t i) const { return data[i]; }
  bool empty() const { return size == 0; }
};

// How a batch came: heard on the topic, or pulled. kLast ends a pull: nothing is missing then.
enum class Arrival : std::uint8_t { kHeard, kPulled, kLast };

// What a batch says besides its arrays. Fields are named, and mean, as in
// rosplat_msgs/GaussianArray.
struct BatchHead {
  std::string map_id;
  std::uint64_t revision = 0;
  std::uint8_t operation = 0;  // GaussianBatch's
  std::uint32_t expected_slots = 0;
  std::uint32_t first_slot = 0;
  std::uint32_t count = 0;
  std::uint32_t group = 0;
  std::uint8_t sh_degree = 0;
  std::string format;      // of the payload; empty: arrays of floats hold the splats
  std::uint8_t model = 0;  // a Model, if it is one
  std::array<double, 3> origin{};
  std::vector<std::string> channel_names;
};

// The fields that are the same in a message, in the batches of publishers and receivers, and in
// Python. Whoever reads or writes batches goes through this list; origin, groups and poses have
// types of their own everywhere.
// clang-format off
#define ROSPLAT_BATCH_FIELDS(FIELD) \
  FIELD(map_id) FIELD(revision) FIELD(operation) FIELD(expected_slots) \
  FIELD(first_slot) FIELD(count) FIELD(slots) FIELD(group) FIELD(sh_degree) \
  FIELD(format) FIELD(payload) FIELD(model) FIELD(channel_names) FIELD(channels)
// clang-format on

// Arrays that are only received: our publishers send groups with their poses, and splats as
// payload.
#define ROSPLAT_RECEIVED_ARRAYS(FIELD) \
  FIELD(groups) FIELD(positions) FIELD(orientations) FIELD(scales) FIELD(opacities) FIELD(sh)

// One batch of edits as it arrives, not yet checked.
struct GaussianBatch : BatchHead {
  enum Operation : std::uint8_t { REPLACE = 0, UPSERT = 1, DELETE = 2, MOVE = 3 };

  Arrival arrival = Arrival::kHeard;
  ArrayView<std::uint32_t> slots;
  ArrayView<std::uint32_t> groups;
  std::vector<Pose> poses;          // of `groups`; quaternions of any length but zero
  ArrayView<std::uint8_t> payload;  // the splats, if there is a format
  ArrayView<float> positions;       // 3 a splat [m]
  ArrayView<float> orientations;    // 4 a splat, x y z w
  ArrayView<float> scales;          // 3 a splat [m]
  ArrayView<float> opacities;       // 1 a splat
  ArrayView<float> sh;              // 3 (sh_degree + 1)^2 a splat
  ArrayView<float> channels;        // 1 a splat for the first name, then for the next
};

}  // namespace rosplat
