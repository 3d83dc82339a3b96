#pragma once

namespace rosplat {

// Lowers the priority of this thread and of threads that it starts: what draws frames goes first.
void giveWay();

}  // namespace rosplat
