#pragma once

namespace rosplat {

// Has this thread, and those that it starts, give way to what shows pictures.
void giveWay();

}  // namespace rosplat
