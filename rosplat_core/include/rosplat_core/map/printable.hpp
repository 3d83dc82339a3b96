#pragma once

#include <cstddef>
#include <string>

namespace rosplat {

// A peer's text for a log or the Status: one line of at most `most` + 3 bytes, and a note if it is
// cut. Control characters are escaped as \xhh.
std::string printable(const std::string& text, std::size_t most = 1000);

}  // namespace rosplat
