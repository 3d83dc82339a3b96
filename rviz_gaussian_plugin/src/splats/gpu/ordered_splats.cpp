#include "gpu/ordered_splats.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr int kPatience = 16;  // frames that need fewer bits until fewer are sorted

}  // namespace

OrderedSplats::OrderedSplats(Shaders& shaders, RadixSort& sort, const Tallies& tallies)
    : tallies_(tallies),
      sort_(sort),
      projection_(shaders, tallies),
      order_program_(shaders.compute({"splat_order.comp"})),
      order_length_(tallies.of(Tallies::kOrder)) {}

bool OrderedSplats::answers(const Frame& frame) const {
  const auto same = [](const Prepared& prepared, const FrameLayer& layer) {
    return prepared.camera == layer.camera && prepared.settings.projectsAs(layer.settings) &&
           prepared.model == layer.model() && prepared.version == layer.store.version() &&
           prepared.error == layer.error &&
           layer.settings.mode != DrawMode::kAge;  // ages change with time
  };
  return kept_ && order_ == frame.order && (depths_ || !frame.depths) &&
         std::equal(prepared_.begin(), prepared_.end(), frame.layers.begin(), frame.layers.end(),
                    same);
}

void OrderedSplats::prepare(const Frame& frame, double growth) {
  kept_ = false;
  prepared_.clear();
  for (const FrameLayer& layer : frame.layers) {
    prepared_.push_back(
        {layer.camera, layer.settings, layer.model(), layer.store.version(), layer.error});
  }
  depths_ = frame.depths;
  if (order_ != frame.order) takeOrder(frame.order);
  projection_.prepare(frame, growth);
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
  const auto count = static_cast<GLuint>(order->slots.size());
  order_length_.write(&count, sizeof(count));
  order_ = order;
}

void OrderedSplats::putInOrder(std::uint32_t capacity) {
  const std::size_t bytes = std::max(projection_.room(), most()) * sizeof(GLuint);
  if (drawn_used_.noteUse(bytes)) drawn_.release();
  drawn_.reserve(bytes, order_ ? bytes / 8 : 0);
  if (!order_) return sort_.order(projection_.seen(), most(), expected(), key_bits_, drawn_);
  if (order_->slots.empty()) return;
  page_numbers_.upload(projection_.pages().numbers(capacity));
  order_program_.bind("Keys", sort_.keys());
  order_program_.bind("Numbers", page_numbers_);
  order_program_.bind("Order", slots_);
  order_program_.bind("Drawn", drawn_);
  order_program_.use();
  order_program_.set("count", static_cast<GLuint>(order_->slots.size()));
  order_program_.set("capacity", capacity);
  gl::dispatchInvocations(order_->slots.size());
  gl::storageBarrier();
}

bool OrderedSplats::checkBits() {
  const GLuint seen = tallies_.wait(Tallies::kSeen, Tallies::kNumber),
               nearest = tallies_.wait(Tallies::kSeen, Tallies::kNearest),
               farthest = tallies_.wait(Tallies::kSeen, Tallies::kFarthest);
  count_ = order_ ? order_->slots.size() : seen;
  counts_ = projection_.ofLayers(count_);
  if (order_) return kept_ = true;
  const int bits = farthest > nearest ? bitsOf(farthest - nearest) : 1;
  const int key_bits =
      (bits + RadixSort::kDigitBits - 1) / RadixSort::kDigitBits * RadixSort::kDigitBits;
  kept_ = key_bits <= key_bits_;
  fewer_bits_for_ = key_bits < key_bits_ ? fewer_bits_for_ + 1 : 0;
  if (!kept_ || fewer_bits_for_ > kPatience) {
    key_bits_ = key_bits;
    fewer_bits_for_ = 0;
  }
  return kept_;
}

bool OrderedSplats::hasBalls() const {
  return std::any_of(prepared_.begin(), prepared_.end(),
                     [](const Prepared& prepared) { return drawsBalls(prepared.settings.mode); });
}

std::size_t OrderedSplats::bytes() const {
  return projection_.bytes() + slots_.bytes() + page_numbers_.bytes() + drawn_.bytes();
}

}  // namespace rosplat
