#include "gpu/ordered_splats.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr std::size_t kLeastRoom = 65536;  // for visible splats
constexpr int kPatience = 16;              // frames that need fewer bits until fewer are sorted

}  // namespace

OrderedSplats::OrderedSplats(Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : tallies_(tallies),
      sort_(sort),
      projection_(shaders, tallies),
      order_program_(shaders.compute({"splat_visible.glsl", "splat_order.comp"})),
      order_length_(tallies.of(Tallies::kOrder)) {}

bool OrderedSplats::answers(const Frame& frame) const {
  const auto same = [](const Prepared& prepared, const FrameLayer& layer) {
    return prepared.camera == layer.camera && prepared.settings.projectsAs(layer.settings) &&
           prepared.model == layer.model() && prepared.version == layer.store.version() &&
           prepared.error == layer.error &&
           layer.settings.mode != DrawMode::kAge;  // ages change with time
  };
  return kept_ && order_ == frame.order &&
         std::equal(prepared_.begin(), prepared_.end(), frame.layers.begin(), frame.layers.end(),
                    same);
}

void OrderedSplats::prepare(const Frame& frame) {
  kept_ = false;
  prepared_.clear();
  std::size_t slots = 0;
  for (const FrameLayer& layer : frame.layers) {
    prepared_.push_back(
        {layer.camera, layer.settings, layer.model(), layer.store.version(), layer.error});
    slots += layer.store.slots();
  }
  if (order_ != frame.order) takeOrder(frame.order);
  std::size_t room = std::min(slots, kLeastRoom);
  if (used_.wastes(visible_)) {
    projection_.release();
    drawn_.release();
    room = std::max(room, withSlack(visible_));
  }
  projection_.prepare(frame.shapes());
  projection_.reserve(room);
  sort_.reserve(projection_.room());
  projection_.run(frame, sort_.keys());
  frame.stopwatch.lap("project");
  putInOrder(frame.layers.front().store.capacity());
  frame.stopwatch.lap("sort");
}

void OrderedSplats::takeOrder(const OrderPtr& order) {
  order_ = nullptr;  // stays so if memory is lacking
  if (!order) return slots_.release();
  if (!order->slots.empty()) slots_.upload(order->slots);
  tell(order_length_, order->slots.size());
  order_ = order;
}

void OrderedSplats::putInOrder(std::uint32_t capacity) {
  const std::size_t bytes = std::max(projection_.room(), most()) * sizeof(GLuint);
  drawn_.reserve(bytes, order_ ? bytes / 8 : 0);
  if (!order_) {
    sort_.order(projection_.seen(), expected(), key_bits_, drawn_);
    return;
  }
  if (order_->slots.empty()) return;
  page_numbers_.upload(projection_.pages().numbers(capacity));
  projection_.bindVisible(order_program_);
  order_program_.bind("Numbers", page_numbers_);
  order_program_.bind("Order", slots_);
  order_program_.bind("Drawn", drawn_);
  order_program_.use();
  order_program_.set("count", static_cast<GLuint>(order_->slots.size()));
  order_program_.set("capacity", capacity);
  order_program_.set("room", static_cast<GLuint>(projection_.room()));
  gl::dispatchInvocations(order_->slots.size());
  gl::storageBarrier();
}

bool OrderedSplats::checkRoom(std::size_t most, double growth) {
  const GLuint visible = tallies_.wait(Tallies::kSeen, Tallies::kWanted),
               nearest = tallies_.wait(Tallies::kSeen, Tallies::kNearest),
               farthest = tallies_.wait(Tallies::kSeen, Tallies::kFarthest);
  visible_ = visible;
  count_ = order_ ? order_->slots.size() : visible;
  counts_ = projection_.visibleOf(count_);
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

bool OrderedSplats::hasBalls() const {
  return std::any_of(prepared_.begin(), prepared_.end(),
                     [](const Prepared& prepared) { return drawsBalls(prepared.settings.mode); });
}

std::size_t OrderedSplats::bytes() const {
  return projection_.bytes() + slots_.bytes() + page_numbers_.bytes() + drawn_.bytes();
}

}  // namespace rosplat
