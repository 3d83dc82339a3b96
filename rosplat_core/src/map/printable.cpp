#include "rosplat_core/map/printable.hpp"

namespace rosplat {

std::string printable(const std::string& text, std::size_t most) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string line;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto byte = static_cast<unsigned char>(text[i]);
    const bool inside = (byte & 0xc0u) == 0x80u;  // a character in UTF-8
    if (!inside && line.size() >= most) {
      return line + "... (" + std::to_string(text.size()) + " bytes)";
    }
    if (byte < 0x20 || byte == 0x7f) {
      line += {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15u]};
    } else if (!inside || line.size() < most + 3) {
      line += text[i];
    }
  }
  return line;
}

}  // namespace rosplat
