#pragma once

#include <cstddef>
#include <string>

namespace rosplat {

// What came from a peer, as a log or the Status may show it: one line of so many bytes at most and
// what says that there was more. Control characters are escaped as \xhh.
std::string printable(const std::string& text, std::size_t most = 1000);

}  // namespace rosplat
