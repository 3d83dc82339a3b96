#include "gpu/ordered_splats.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr std::size_t kLeastRoom = 65536;  // for visible splats
constexpr int kPatience = 16;              // frames until fewer bits are sorted

}  // namespace

OrderedSplats::OrderedSplats(const Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : tallies_(tallies),
      sort_(sort),
      projection_(shaders, tallies),
      order_program_(shaders.compute({"splat_visible.glsl", "splat_order.comp"})),
      order_(tallies) {}

void OrderedSplats::setOrder(const std::uint32_t* slots, std::size_t count) {
  order_.given = true;
  order_.count = count;
  order_.tally.set(count);
  order_.slots.reserve(count * sizeof(std::uint32_t));
  if (count > 0) order_.slots.write(0, slots, count * sizeof(std::uint32_t));
  forget();
}

void OrderedSplats::sortByDepth() {
  if (order_.given) forget();
  order_.given = false;
}

bool OrderedSplats::answers(const SplatCamera& camera, const MapState& map,
                            const RenderSettings& settings) const {
  return kept_ && prepared_.camera == camera && prepared_.settings.projectsAs(settings) &&
         prepared_.origin == map.origin && prepared_.antialiased == map.antialiased &&
         settings.mode != DrawMode::kAge;  // which changes with time
}

bool OrderedSplats::prepare(const SlotStore& store, const SplatCamera& camera, const MapState& map,
                            const RenderSettings& settings, double now, gl::Stopwatch& stopwatch) {
  if (answers(camera, map, settings)) return false;
  prepared_ = {camera, settings, map.origin, map.antialiased};
  forget();
  projection_.reserve(std::min(store.slots(), kLeastRoom));
  sort_.reserve(projection_.room());
  projection_.run(store, camera, map, settings, now, sort_.keys());
  stopwatch.lap("project");
  putInOrder(store.capacity());
  stopwatch.lap("sort");
  return true;
}

void OrderedSplats::putInOrder(std::uint32_t capacity) {
  drawn_.reserve(std::max(projection_.room(), order_.given ? order_.count : 0) * sizeof(GLuint));
  if (!order_.given) {
    sort_.order(projection_.visible(), projection_.depthRange(), key_bits_, drawn_);
    return;
  }
  if (order_.count == 0) return;
  order_program_.use();
  projection_.bindVisible();
  page_numbers_.upload(projection_.pages().numbers(capacity));
  page_numbers_.bind(9);
  order_.slots.bind(7);
  drawn_.bind(8);
  order_program_.set("count", static_cast<GLuint>(order_.count));
  order_program_.set("capacity", capacity);
  order_program_.set("room", static_cast<GLuint>(projection_.room()));
  gl::dispatchInvocations(order_.count);
  gl::storageBarrier();
}

bool OrderedSplats::checkRoom(std::size_t most, double growth) {
  const GLuint visible = tallies_.wait(Tallies::kVisible, Tally::kWanted),
               nearest = tallies_.wait(Tallies::kDepthRange, 0),
               farthest = tallies_.wait(Tallies::kDepthRange, 1);
  count_ = order_.given ? order_.count : visible;
  bool enough = true;
  if (visible > projection_.room()) {
    projection_.reserve(std::min(withSlack(visible, growth), most));
    enough = false;
  }
  const int bits = farthest > nearest ? bitsOf(farthest - nearest) : 1;
  const int key_bits =
      (bits + RadixSort::kDigitBits - 1) / RadixSort::kDigitBits * RadixSort::kDigitBits;
  fewer_bits_for_ = key_bits < key_bits_ ? fewer_bits_for_ + 1 : 0;
  if (key_bits > key_bits_ || fewer_bits_for_ > kPatience) {
    enough = enough && key_bits < key_bits_;
    key_bits_ = key_bits;
    fewer_bits_for_ = 0;
  }
  kept_ = enough;
  return enough;
}

std::size_t OrderedSplats::bytes() const {
  return projection_.bytes() + order_.slots.bytes() + page_numbers_.bytes() + drawn_.bytes();
}

}  // namespace rosplat
