#include "view_names.hpp"

#include <algorithm>
#include <utility>

namespace rosplat {

const std::string& ViewNames::join(const std::vector<std::string>& view_ids, const Unused& unused) {
  std::string name = view_ids.front();
  for (const std::string& view_id : view_ids) {
    if (const std::string* const known = of(view_id)) {
      name = *known;
      break;
    }
  }
  for (const std::string& view_id : view_ids) {
    const std::string before = std::exchange(names_[view_id], name);
    if (!before.empty() && !inUse(before)) unused(before);
  }
  return names_[view_ids.front()];
}

void ViewNames::forget(const std::string& view_id, const Unused& unused) {
  const auto found = names_.find(view_id);
  if (found == names_.end()) return;
  const std::string name = found->second;
  names_.erase(found);
  if (!inUse(name)) unused(name);
}

const std::string* ViewNames::of(const std::string& view_id) const {
  const auto found = names_.find(view_id);
  return found == names_.end() ? nullptr : &found->second;
}

bool ViewNames::inUse(const std::string& name) const {
  return std::any_of(names_.begin(), names_.end(),
                     [&name](const auto& shown) { return shown.second == name; });
}

}  // namespace rosplat
