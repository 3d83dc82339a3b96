#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace rosplat {

// Quality of service of a map's topic: what a publisher offers, or a subscription asks for.
struct MapQos {
  bool reliable = true;
  bool transient_local = true;
  std::size_t depth = 1000;  // a publisher without pulls may keep so many batches

  bool operator==(const MapQos& other) const {
    return reliable == other.reliable && transient_local == other.transient_local &&
           depth == other.depth;
  }
};

// What a subscription is to ask for, and what of the offers it then doesn't hear.
struct MapQosChoice {
  MapQos qos;
  bool best_effort_unheard = false;
  bool volatile_unheard = false;
};

// A subscription that asks for more than a publisher offers doesn't hear it, and never two
// subscriptions hear one topic: so a policy is given up only where no publisher offers it. Where
// pulls are served, only the newest batches need to wait for a receiver that is slow. It asks for
// transient local even there: in Fast DDS 2.14, a volatile reader that joins amid the fragments of
// a message may hang.
inline MapQosChoice chooseMapQos(const MapQos& wished, const std::vector<MapQos>& offers,
                                 bool served) {
  constexpr std::size_t kServedDepth = 8;
  const auto any = [&offers](bool MapQos::* policy, bool value) {
    return std::any_of(offers.begin(), offers.end(),
                       [&](const MapQos& offer) { return offer.*policy == value; });
  };
  MapQosChoice choice{wished};
  MapQos& qos = choice.qos;
  if (served) qos.depth = std::clamp<std::size_t>(qos.depth, 1, kServedDepth);
  qos.reliable &= offers.empty() || any(&MapQos::reliable, true);
  qos.transient_local &= offers.empty() || any(&MapQos::transient_local, true);
  choice.best_effort_unheard = qos.reliable && any(&MapQos::reliable, false);
  choice.volatile_unheard = qos.transient_local && any(&MapQos::transient_local, false);
  return choice;
}

}  // namespace rosplat
