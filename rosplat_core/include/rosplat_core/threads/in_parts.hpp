#pragma once

#include <atomic>
#include <cstddef>
#include <new>
#include <type_traits>

#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// Calls step(number), or step(number, member) as ThreadTeam::run() does, for each number below
// count, in parallel if there is a team. If any step throws std::bad_alloc, throws that once all
// steps have ended.
template <typename Step>
void inParts(ThreadTeam* team, std::size_t count, const Step& step) {
  std::atomic<bool> out_of_memory{false};
  const auto task = [&](unsigned number, unsigned member) {
    try {
      if constexpr (std::is_invocable_v<Step, unsigned, unsigned>) {
        step(number, member);
      } else {
        step(number);
      }
    } catch (const std::bad_alloc&) {
      out_of_memory = true;
    }
  };
  if (team) {
    team->run(static_cast<unsigned>(count), task);
  } else {
    for (unsigned number = 0; number < count; ++number) task(number, 0);
  }
  if (out_of_memory) throw std::bad_alloc();
}

}  // namespace rosplat
